# SPDX-License-Identifier: Apache-2.0
"""Parameters of a node: declared from dataclasses, checked at every change, named when unknown.

A node with parameters runs in a thread; a plain rclpy client asks it, as any tool does.
"""

import threading
from dataclasses import dataclass
from math import inf
from typing import ClassVar

import pytest
import rclpy
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python

from fiber_core.bounds import Range, check_ranges
from fiber_core.errors import FiberError
from fiber_node import ParameterError, PlaneNode, ThreadExecutor

pytestmark = pytest.mark.timeout(60)

WAIT_S = 20.0


@dataclass(frozen=True)
class Law:
    """A law.

    Args:
        gain: how strong the pull is [1/s].
        horizon_s: end of the plan [s]; None for
            the time of the slowest robot.
        budget_s: computing time [s].
        method: name of the method.
        rounds: number of rounds.
        watch: ids that are shown.
        files: files that are read.
    """

    RANGES: ClassVar = {"gain": Range(0.5, 10.0), "rounds": Range(0, 9, whole=True)}
    CHOICES: ClassVar = {"method": ("plain", "fancy")}

    gain: float = 2.0
    horizon_s: float | None = None
    budget_s: float = inf
    method: str = "plain"
    rounds: int = 3
    watch: tuple[int, ...] = (0,)
    files: tuple[str, ...] = ("",)
    table: tuple[int, ...] = ()

    def __post_init__(self):
        check_ranges(self, self.RANGES, FiberError)
        if self.method not in self.CHOICES["method"]:
            raise FiberError(f"no method is called {self.method!r}")
        if self.rounds == 9 and self.gain > 9:
            raise FiberError("9 rounds do not go with a gain above 9")


class LawNode(PlaneNode):
    """A node with a law that can change, and one that cannot."""

    def __init__(self, **options):
        super().__init__("law", **options)
        self.law = self.parameters.declare(Law, "core")
        self.fixed = self.parameters.declare(Law, "fixed", read_only=True)
        self.parameters.finish()


class Rig:
    """The node in one thread and a client of its parameters in another context."""

    def __init__(self, domain, args=(), **parameters):
        self.context = Context()
        rclpy.init(args=list(args), context=self.context, domain_id=domain)
        overrides = [Parameter(name.replace("__", "."), value=v) for name, v in parameters.items()]
        self.node = LawNode(context=self.context, parameter_overrides=overrides)
        self.executor = ThreadExecutor(2, context=self.context)
        self.executor.add_node(self.node)
        self.thread = threading.Thread(target=self.executor.spin)
        self.thread.start()
        self.client_context = Context()
        rclpy.init(args=[], context=self.client_context, domain_id=domain)
        self.client = Node("stranger", context=self.client_context)
        self.spinner = SingleThreadedExecutor(context=self.client_context)
        self.spinner.add_node(self.client)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.executor.stop()
        self.thread.join()
        self.executor.shutdown()
        self.node.destroy_node()
        self.spinner.shutdown()
        self.client.destroy_node()
        self.context.try_shutdown()
        self.client_context.try_shutdown()

    def call(self, kind, service, **fields):
        client = self.client.create_client(kind, service)
        assert client.wait_for_service(WAIT_S)
        future = client.call_async(kind.Request(**fields))
        self.spinner.spin_until_future_complete(future, WAIT_S)
        return future.result()

    def get(self, *names):
        answer = self.call(GetParameters, "/law/get_parameters", names=list(names))
        return [parameter_value_to_python(value) for value in answer.values]

    def set(self, **values):
        parameters = [
            Parameter(name.replace("__", "."), value=v).to_parameter_msg()
            for name, v in values.items()
        ]
        (*_, result) = self.call(
            SetParameters, "/law/set_parameters", parameters=parameters
        ).results
        return result


@pytest.fixture
def rig(new_domain):
    with Rig(new_domain()) as made:
        yield made


def test_each_parameter_has_a_sentence_a_range_and_a_value(rig):
    names = rig.call(ListParameters, "/law/list_parameters").result.names
    described = rig.call(DescribeParameters, "/law/describe_parameters", names=names).descriptors
    about = {each.name: each for each in described}
    assert about["core.gain"].description == "How strong the pull is [1/s]."
    assert about["core.horizon_s"].description == (
        "End of the plan [s]; None for the time of the slowest robot. 0.0 stands for None."
    )
    assert about["core.budget_s"].description == "Computing time [s]. 0.0 stands for no limit."
    (gain,) = about["core.gain"].floating_point_range
    (rounds,) = about["core.rounds"].integer_range
    assert (gain.from_value, gain.to_value) == (0.5, 10.0)
    assert (rounds.from_value, rounds.to_value) == (0, 9)
    assert about["core.method"].additional_constraints == "one of plain, fancy"
    assert about["fixed.gain"].read_only and not about["core.gain"].read_only
    assert not rig.node.has_parameter("core.table")
    values = rig.call(GetParameters, "/law/get_parameters", names=names).values
    assert all(value.type != ParameterType.PARAMETER_NOT_SET for value in values)
    assert rig.get("core.horizon_s", "core.budget_s") == [0.0, 0.0]
    assert rig.node.law.value == Law(files=())


def test_a_change_is_in_effect_or_refused_with_the_reason(rig, capfd):
    assert rig.set(core__gain=3.0).successful and rig.node.law.value.gain == 3.0
    assert rig.set(core__gain=4).successful  # a whole number serves
    assert rig.get("core.gain") == [4.0] and rig.node.law.value.gain == 4.0
    for text in ("1e-5", "2.5"):  # what YAML takes for a text, as ros2cli hands it over
        assert not rig.set(core__gain="1e-5").successful
        assert rig.set(core__budget_s=text).successful
        assert rig.node.law.value.budget_s == float(text)
    assert rig.set(core__horizon_s=9.5).successful and rig.node.law.value.horizon_s == 9.5
    assert rig.set(core__horizon_s=0.0).successful and rig.node.law.value.horizon_s is None
    assert rig.set(core__watch=[4, 5]).successful and rig.node.law.value.watch == (4, 5)
    before = rig.node.law.value
    for change, word in (
        ({"core__gain": -1.0}, "core.gain out of range"),
        ({"core__gain": float("nan")}, "core.gain out of range"),
        ({"core__rounds": 10}, "core.rounds"),
        ({"core__method": "bogus"}, "no method is called 'bogus'"),
        ({"core__gain": "much"}, "type"),
        ({"core__gain": "nan"}, "core.gain out of range"),
        ({"core__rounds": "3"}, "type"),
        ({"fixed__gain": 3.0}, "read-only"),
        ({"unknown": 3.0}, "parameter unknown does not exist"),
        ({"gain": 3.0}, "did you mean core.gain or fixed.gain?"),
    ):
        result = rig.set(**change)
        assert not result.successful and word in result.reason, result.reason
    assert rig.node.law.value == before and rig.get("core.gain") == [4.0]
    log = capfd.readouterr().err
    assert "parameter core.gain is now 4.0, in effect from the next plan" in log
    assert "parameter change refused: no method is called 'bogus'" in log
    assert "parameter change refused: parameter unknown does not exist" in log


def test_a_value_that_a_parameter_has_already_is_no_change_in_the_log(rig, capfd):
    assert rig.set(core__gain=2.0, core__method="plain", core__horizon_s=0.0).successful
    assert rig.set(core__rounds=4).successful
    log = capfd.readouterr().err
    assert "parameter core.rounds is now 4" in log and log.count("is now") == 1


def test_changes_are_checked_together(rig):
    assert rig.set(core__rounds=9).successful
    result = rig.set(core__gain=9.5)
    assert not result.successful and "9 rounds do not go" in result.reason
    assert rig.node.law.value.gain == 2.0


def test_what_is_given_at_the_start_is_converted_checked_and_named_if_unknown(new_domain, capfd):
    args = ["--ros-args", "-p", "core.gain:=3", "-p", "gain:=1.0", "-p", "core.metod:=plain"]
    with Rig(new_domain(), args, fixed__files=["a"]) as rig:
        assert rig.node.law.value.gain == 3.0
        assert rig.node.fixed.value.files == ("a",)
        assert not rig.node.has_parameter("gain")
        assert rig.get("core.gain") == [3.0]
    log = capfd.readouterr().err
    assert "parameter gain does not exist and has no effect; did you mean core.gain" in log
    assert "parameter core.metod does not exist and has no effect; did you mean core.method" in log
    assert "settings: core.gain = 3.0, fixed.files = ['a']" in log


@pytest.mark.parametrize(
    "name, value, word",
    [
        ("core__gain", -1.0, "gain is -1.0"),
        ("core__gain", "much", "parameter core.gain is 'much', expected a number"),
        ("core__rounds", 2.5, "parameter core.rounds is 2.5, expected a whole number"),
        ("core__method", 7, "parameter core.method is 7, expected a text"),
        ("core__watch", ["a"], r"parameter core.watch is \['a'\], expected a list"),
    ],
)
def test_a_wrong_value_at_the_start_is_an_error_with_name_and_value(name, value, word, new_domain):
    with pytest.raises(FiberError, match=word) as error, Rig(new_domain(), **{name: value}):
        pass
    assert isinstance(error.value, ParameterError) or name == "core__gain"


def test_what_a_node_shows_it_takes_at_the_next_start(new_domain, tmp_path):
    file = tmp_path / "dump.yaml"
    with Rig(new_domain(), core__gain=3.5) as rig:
        names = rig.call(ListParameters, "/law/list_parameters").result.names
        lines = [f"    {name}: {_yaml(value)}" for name, value in zip(names, rig.get(*names))]
        file.write_text("/law:\n  ros__parameters:\n" + "\n".join(lines) + "\n")
        before = rig.node.law.value
    with Rig(new_domain(), ["--ros-args", "--params-file", str(file)]) as rig:
        assert rig.node.law.value == before and rig.node.fixed.value == Law(files=())


def test_an_empty_list_in_a_parameter_file_is_taken_as_the_default(new_domain, tmp_path):
    file = tmp_path / "empty.yaml"
    file.write_text("/**/law:\n  ros__parameters:\n    core.watch: []\n    core.gain: 3\n")
    with Rig(new_domain(), ["--ros-args", "--params-file", str(file)]) as rig:
        assert rig.node.law.value == Law(gain=3.0, files=())


def _yaml(value):
    if isinstance(value, str):
        return f"'{value}'"
    text = str(list(value) if hasattr(value, "__len__") else value)
    return text.replace("True", "true").replace("False", "false")
