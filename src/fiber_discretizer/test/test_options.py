# SPDX-License-Identifier: Apache-2.0
"""Options of the discretizer: values that do not exist are refused by name."""

import pytest

from fiber_discretizer import DiscretizeOptions, UnknownOption


@pytest.mark.parametrize(
    "option", [{"sharing": "x"}, {"method": "x"}, {"rule": "x"}, {"first_joint": 2}]
)
def test_unknown_options_are_refused_by_name(option):
    with pytest.raises(UnknownOption, match=next(iter(option))):
        DiscretizeOptions(**option)


@pytest.mark.parametrize(
    ("option", "old", "new"),
    [
        ("sharing", "turns", "sequential"),
        ("sharing", "halves", "makarem2014"),
        ("method", "paper", "douglas_peucker"),
    ],
)
def test_a_renamed_option_value_is_refused_with_its_new_name(option, old, new):
    with pytest.raises(UnknownOption, match=f"{option} '{old}' .*is now called '{new}'"):
        DiscretizeOptions(**{option: old})
