# SPDX-License-Identifier: Apache-2.0
"""Laws of ragged arrays: the same as for a list of arrays."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiber_core.ragged import Parts

COUNTS = st.lists(st.integers(0, 5), max_size=12)


def lists(parts, flat):
    return [flat[parts.slice(k)].tolist() for k in range(len(parts))]


@given(COUNTS)
def test_parts_of_given_lengths_have_these_lengths_and_follow_each_other(counts):
    parts = Parts.from_counts(counts)
    assert parts.counts.tolist() == counts and len(parts) == len(counts)
    assert parts.total == sum(counts) and parts.cover(len(counts), sum(counts))
    assert sum(lists(parts, np.arange(parts.total)), []) == list(range(parts.total))
    assert np.array_equal(parts.first, parts.offsets[:-1]) and parts.offsets.dtype == np.int64


@given(COUNTS)
def test_the_owner_of_an_element_is_the_part_that_contains_it(counts):
    parts = Parts.from_counts(counts)
    assert lists(parts, parts.owner) == [[k] * n for k, n in enumerate(counts)]


@given(COUNTS, st.data())
def test_selected_parts_have_the_elements_of_these_parts_in_the_given_order(counts, data):
    parts = Parts.from_counts(counts)
    chosen = data.draw(st.lists(st.sampled_from(range(len(counts))))) if counts else []
    selected, elements = parts.select(chosen)
    whole = lists(parts, np.arange(parts.total))
    assert lists(selected, elements) == [whole[k] for k in chosen]


@given(COUNTS, st.data())
def test_emptied_parts_lose_their_elements_and_no_other_part_does(counts, data):
    parts = Parts.from_counts(counts)
    empty = data.draw(st.lists(st.booleans(), min_size=len(counts), max_size=len(counts)))
    left, remains = parts.without(empty)
    whole = lists(parts, np.arange(parts.total))
    expected = [[] if e else w for e, w in zip(empty, whole)]
    assert lists(left, np.arange(parts.total)[remains]) == expected


@given(COUNTS, st.data())
def test_replaced_parts_have_the_elements_of_the_other_array_and_the_others_keep_theirs(
    counts, data
):
    parts = Parts.from_counts(counts)
    chosen = data.draw(st.lists(st.sampled_from(range(len(counts))), unique=True)) if counts else []
    other = Parts.from_counts(
        data.draw(st.lists(st.integers(0, 5), min_size=len(chosen), max_size=len(chosen)))
    )
    replaced, elements = parts.replaced(chosen, other)
    flat = np.concatenate([np.arange(parts.total), 100 + np.arange(other.total)])
    expected = lists(parts, flat)
    for part, elements_of_other in zip(chosen, lists(other, flat[parts.total :])):
        expected[part] = elements_of_other
    assert lists(replaced, flat[elements]) == expected


@given(COUNTS, st.booleans(), st.integers(0, 2**32 - 1))
def test_sums_and_running_sums_are_those_of_each_part_alone(counts, whole, seed):
    parts = Parts.from_counts(counts)
    rng = np.random.default_rng(seed)
    values = rng.integers(-9, 9, parts.total) if whole else rng.normal(size=parts.total)
    running = parts.running(values)
    expected = [[0, *np.cumsum(values[parts.slice(k)]).tolist()] for k in range(len(parts))]
    assert lists(parts.knots, running) == expected and parts.knots.total == len(running)
    assert parts.sums(values).tolist() == [part[-1] for part in expected]
    assert lists(parts, parts.before(values)) == [part[:-1] for part in expected]
    for result in (running, parts.sums(values), parts.before(values)):
        assert result.dtype == values.dtype


@given(COUNTS)
def test_parts_are_found_again_from_the_owners_of_their_elements(counts):
    parts = Parts.from_counts(counts)
    assert np.array_equal(Parts.from_owners(parts.owner, len(parts)).offsets, parts.offsets)


@given(COUNTS, st.data())
def test_selecting_twice_is_selecting_once(counts, data):
    parts = Parts.from_counts(counts)
    rows = st.lists(st.sampled_from(range(len(counts)))) if counts else st.just([])
    first = np.array(data.draw(rows), dtype=np.int64)
    second = data.draw(st.lists(st.sampled_from(range(len(first))))) if len(first) else []
    once, elements = parts.select(first)
    twice, of_these = once.select(second)
    both, directly = parts.select(first[second])
    assert np.array_equal(twice.offsets, both.offsets)
    assert np.array_equal(elements[of_these], directly)


@given(COUNTS)
def test_selecting_all_parts_changes_nothing_and_emptying_all_leaves_nothing(counts):
    parts = Parts.from_counts(counts)
    same, elements = parts.select(np.arange(len(parts)))
    assert np.array_equal(same.offsets, parts.offsets)
    assert np.array_equal(elements, np.arange(parts.total))
    empty, remains = parts.without(np.ones(len(parts), dtype=bool))
    assert len(empty) == len(parts) and empty.total == 0 and not remains.any()


@given(COUNTS, COUNTS)
def test_parts_of_joined_arrays_are_selected_apart_again(one, two):
    joined = Parts.concatenate([Parts.from_counts(one), Parts.from_counts(two)])
    first, elements = joined.select(np.arange(len(one)))
    assert first.counts.tolist() == one and np.array_equal(elements, np.arange(sum(one)))
    second, elements = joined.select(len(one) + np.arange(len(two)))
    assert second.counts.tolist() == two
    assert np.array_equal(elements, sum(one) + np.arange(sum(two)))


@given(st.lists(COUNTS, max_size=4))
def test_concatenated_parts_are_those_of_the_joined_arrays(many):
    joined = Parts.concatenate([Parts.from_counts(counts) for counts in many])
    assert joined.counts.tolist() == sum(many, [])


@given(COUNTS)
def test_a_table_of_counts_is_read_row_by_row(counts):
    table = np.stack([counts, counts[::-1]], axis=1)
    assert np.array_equal(Parts.from_counts(table).counts, table.ravel())
    assert Parts.from_counts(table > 0).total == np.count_nonzero(table)


@pytest.mark.parametrize(
    "offsets, parts, total",
    [([0, 2, 1], 2, 1), ([1, 2, 3], 2, 3), ([0, 1, 2], 2, 3), ([0, 1, 2], 3, 2), ([], 0, 0)],
)
def test_offsets_that_do_not_rise_from_zero_to_the_end_do_not_cover_an_array(offsets, parts, total):
    assert not Parts(np.array(offsets, dtype=np.int64)).cover(parts, total)
