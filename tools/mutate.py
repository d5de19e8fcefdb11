# SPDX-License-Identifier: Apache-2.0
"""Mutation tests: plants small mistakes, one at a time, and counts those that the tests notice.

A mutant is imported from memory, in a process of its own that is forked after the large libraries
are imported. The tests that reach the line run, the fastest first, until one fails. Verdicts are
kept in out/mutate, so that a run goes on where the last one ended; a survivor is judged again when
a test changes. Reasons: docs/decisions/0015-mutation-tests.md.
"""

import argparse
import hashlib
import importlib.abc
import importlib.util
import json
import multiprocessing
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import coverage
import hypothesis
import pytest
import scipy.spatial  # noqa: F401 - imported once instead of in every process
from mutants import Mutant, mutants_of
from mutate_report import write_report
from numba.core import config

ROOT = Path(__file__).parents[1]
OUT = ROOT / "out" / "mutate"
_OPTIONS = ["-x", "-q", "--tb=native", "-p", "no:cacheprovider", "-p", "no:rerunfailures"]
_NUMBA: Any = config  # settings of numba in this process
_LONGER, _MORE_S = 4, 6  # a test may need so many times its processor time, and so much more [s]
_COMPILING_S = 60  # and so much more where it has to compile first [s]


@dataclass(frozen=True)
class Target:
    """Modules and the tests that judge them, a table of tools/mutate.toml.

    Args:
        name: its name.
        modules: the files in which mistakes are planted.
        tests: the files of the tests.
        interpreted: tests run without compilation first.
        slow_s: processor time from which a test is slow [s].
    """

    name: str
    modules: list[Path]
    tests: list[Path]
    interpreted: bool
    slow_s: float

    def digest(self, *paths: Path) -> str:
        """Digest of some files and of all that tests share."""
        helpers = self.tests[0].parent.glob("[!t]*.py")
        return _digest({*paths, *helpers})


def _digest(paths: Iterable[Path]) -> str:
    texts = b"".join(path.read_bytes() for path in sorted(paths))
    return hashlib.sha256(texts).hexdigest()[:16]


class _Importer(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    # imports one module from the text of a mutant

    def __init__(self, mutant: Mutant):
        self.mutant = mutant

    def find_spec(self, fullname, path=None, target=None):
        if fullname == self.mutant.module:
            return importlib.util.spec_from_loader(fullname, self, origin=str(self.mutant.path))
        return None

    def exec_module(self, module) -> None:
        module.__file__ = str(self.mutant.path)
        exec(compile(self.mutant.text, str(self.mutant.path), "exec"), module.__dict__)


class _Judge:
    # runs chosen tests, the fastest first, each for a limited processor time

    def __init__(self, seconds: dict[str, float], more_s: float, tell: Callable[[str], None]):
        self.seconds, self.more_s, self.tell = seconds, more_s, tell

    @pytest.hookimpl(tryfirst=True)
    def pytest_collection(self):
        # one failing example is enough, the smallest one is not looked for
        phases = (hypothesis.Phase.explicit, hypothesis.Phase.generate)
        hypothesis.settings.register_profile("mutate", hypothesis.settings(), phases=phases)
        hypothesis.settings.load_profile("mutate")

    def pytest_collection_modifyitems(self, items):
        chosen = [item for item in items if item.nodeid in self.seconds]
        items[:] = sorted(chosen, key=lambda item: self.seconds[item.nodeid])

    def pytest_runtest_logstart(self, nodeid):
        self.tell(nodeid)
        limit = time.process_time() + self.more_s + _LONGER * self.seconds[nodeid]
        resource.setrlimit(resource.RLIMIT_CPU, (int(limit) + 1, resource.RLIM_INFINITY))


class _Mapper:
    # notes which lines each test reaches, and its processor time; gives slow tests up

    def __init__(self, tracer: coverage.Coverage, slow_s: float):
        self.tracer, self.slow_s = tracer, slow_s
        self.seconds: dict[str, float] = {}

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item):
        least_s = 0.0

        def give_up(*_):
            nonlocal least_s
            least_s = self.slow_s
            pytest.skip("slow")

        self.tracer.switch_context(item.nodeid)
        signal.signal(signal.SIGPROF, give_up)
        signal.setitimer(signal.ITIMER_PROF, self.slow_s)
        began = time.process_time()
        result = yield
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        self.seconds[item.nodeid] = max(time.process_time() - began, least_s)
        self.tracer.switch_context("")
        return result


class SuiteError(RuntimeError):
    """The tests cannot run."""


def _forked(work: Callable[[Callable[[str], None]], int]) -> tuple[int, list[str], Path]:
    # run some work in a process of its own; its exit code, the lines it tells, and its output
    read, write = os.pipe()
    log = OUT / f"{os.getpid()}.log"
    pid = os.fork()
    if pid == 0:
        code = 98
        try:
            os.close(read)
            told = os.fdopen(write, "w")
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(output, 1)
            os.dup2(output, 2)
            code = work(lambda line: print(line, file=told, flush=True))
        finally:
            os._exit(code)
    os.close(write)
    with os.fdopen(read) as reader:
        lines = reader.read().splitlines()
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), lines, log


def _map(target: Target, tests: Path) -> dict:
    """Return processor time, modules and lines of every test of a file, and the slow tests.

    They are kept until a module or the tests change.
    """
    kept = OUT / f"{tests.stem}-{target.digest(tests, *target.modules)}.json"
    if kept.exists():
        return json.loads(kept.read_text())

    def work(tell) -> int:
        _NUMBA.DISABLE_JIT = target.interpreted
        tracer = coverage.Coverage(data_file=None, include=[str(path) for path in target.modules])
        mapper = _Mapper(tracer, target.slow_s)
        tracer.start()
        code = pytest.main([*_OPTIONS, str(tests)], plugins=[mapper])
        tracer.stop()
        data, lines = tracer.get_data(), {}
        for path in target.modules:
            for line, reached_by in data.contexts_by_lineno(str(path)).items():
                lines[f"{path.stem}:{line}"] = sorted(reached_by)
        kept.write_text(json.dumps({"seconds": mapper.seconds, "lines": lines}))
        return int(code)

    print(f"which lines {tests.name} reaches", flush=True)
    code, _, log = _forked(work)
    if code:
        raise SuiteError(f"{tests.name} fails without a mutant: {log}")
    return json.loads(kept.read_text())


class Suite:
    """The tests of a target, and what is known of them."""

    def __init__(self, target: Target):
        self.target = target
        self.maps = {path: _map(target, path) for path in target.tests}

    def reaching(self, mutant: Mutant) -> dict[str, float]:
        """Return the tests that reach a mutant and their processor times [s].

        A line that runs when its module is imported is reached by all tests, and so is a line that
        no test is seen to reach unless all run interpreted: it may be in a compiled loop.
        """
        found: dict[str, float] = {}
        for known in self.maps.values():
            at = [f"{mutant.path.stem}:{k}" for k in range(*mutant.reached_by)]
            at.append(f"{mutant.path.stem}:{mutant.reached_by[1]}")
            tests = {test for line in at for test in known["lines"].get(line, [])}
            tests = set(known["seconds"]) if "" in tests else tests
            found |= {test: known["seconds"][test] for test in tests}
        if not found and not self.target.interpreted:
            found = {k: s for known in self.maps.values() for k, s in known["seconds"].items()}
        return {test: s for test, s in found.items() if s < self.target.slow_s}

    def slow(self) -> dict[str, float]:
        """Return the slow tests and their processor times [s]."""
        return {
            test: seconds
            for known in self.maps.values()
            for test, seconds in known["seconds"].items()
            if seconds >= self.target.slow_s
        }

    def judge(self, mutant: Mutant) -> dict:
        """Return the verdict on a mutant: which test killed it, or that it survived."""
        began = time.monotonic()
        verdict = {"survived": True, "test": ""}
        for tests, compiled in (
            (self.reaching(mutant), not self.target.interpreted),
            (self.slow(), True),
        ):
            if tests and verdict["survived"]:
                verdict = self._run(mutant, tests, compiled)
        tests = self.target.digest(*self.target.tests)
        took = round(time.monotonic() - began, 1)
        change = f"{mutant.path.stem}:{mutant.line}: {mutant.change}"
        return verdict | {"key": mutant.key, "tests": tests, "seconds": took, "change": change}

    def _run(self, mutant: Mutant, tests: dict[str, float], compiled: bool) -> dict:
        cache = Path(tempfile.mkdtemp(prefix="cache-", dir=OUT))
        files = sorted({str(ROOT / test.partition("::")[0]) for test in tests})

        def work(tell) -> int:
            _NUMBA.DISABLE_JIT = not compiled
            more_s = _COMPILING_S if compiled else _MORE_S
            _pristine_cache(cache, mutant)
            sys.meta_path.insert(0, _Importer(mutant))
            return int(pytest.main([*_OPTIONS, *files], plugins=[_Judge(tests, more_s, tell)]))

        try:
            code, told, log = _forked(work)
        finally:
            shutil.rmtree(cache)
        if code in (3, 4, 5, 98):
            raise SuiteError(f"pytest ends with {code} on {mutant.change}: {log}")
        ends = "" if code >= 0 else f" ended by signal {-code}"
        return {"survived": code == 0, "test": (told[-1] if told else "import") + ends}


def _pristine_cache(cache: Path, mutant: Mutant) -> None:
    # What numba has compiled, without all that may hold code of the module: its package.
    for folder in Path(_NUMBA.CACHE_DIR).glob("*/"):
        if not folder.name.startswith(f"{mutant.path.parent.name}_"):
            shutil.copytree(folder, cache / folder.name, copy_function=os.link)
    _NUMBA.CACHE_DIR = os.environ["NUMBA_CACHE_DIR"] = str(cache)


def _drawn(suites: list[Suite], count: int, seed: int) -> list[tuple[Suite, Mutant]]:
    # Mutants in an order that depends on the seed alone: a larger sample holds the smaller one.
    every = [
        (suite, mutant)
        for suite in suites
        for path in suite.target.modules
        for mutant in mutants_of(".".join(path.relative_to(ROOT / "src").parts[1:])[:-3], path)
    ]
    every.sort(key=lambda each: hashlib.sha256(f"{seed}:{each[1].key}".encode()).digest())
    return every[:count] if count else every


def _targets(table: dict, name: str) -> list[Target]:
    names = [name] if name else list(table["target"])

    def files(patterns: list[str]) -> list[Path]:
        return sorted(path for pattern in patterns for path in ROOT.glob(pattern))

    return [
        Target(name, files(t["modules"]), files(t["tests"]), t["interpreted"], t["slow_s"])
        for name in names
        for t in [table["target"][name]]
    ]


def _known(suites: list[Suite]) -> dict[str, dict]:
    # Verdicts that still hold: survivors of tests that have changed since are judged again.
    file, current = OUT / "verdicts.jsonl", {s.target.digest(*s.target.tests) for s in suites}
    lines = file.read_text().splitlines() if file.exists() else []
    verdicts = {verdict["key"]: verdict for verdict in map(json.loads, lines)}
    return {k: v for k, v in verdicts.items() if not v["survived"] or v["tests"] in current}


def _prepare() -> None:
    # sources before what is installed of them, and compiled loops apart from those of others
    sources = sorted((ROOT / "src").glob("*/"))
    sys.path[:0] = [str(path) for path in sources]
    os.environ["PYTHONPATH"] = os.pathsep.join(
        [*map(str, sources), os.environ.get("PYTHONPATH", "")]
    )
    os.chdir(ROOT)
    OUT.mkdir(parents=True, exist_ok=True)
    cache = OUT / f"numba-{_digest(ROOT.glob('src/*/*/**/*.py'))}"
    for other in [*OUT.glob("numba-*"), *OUT.glob("cache-*")]:
        if other != cache:
            shutil.rmtree(other)
    cache.mkdir(exist_ok=True)
    _NUMBA.CACHE_DIR = os.environ["NUMBA_CACHE_DIR"] = str(cache)


def main() -> None:
    """Judge a sample of the mutants and write the report."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--mutants", type=int, default=0, help="size of the sample; 0: all")
    parser.add_argument("--seed", type=int, default=0, help="of the sample")
    parser.add_argument("--target", default="", help="a table of tools/mutate.toml; all by default")
    parser.add_argument("--jobs", type=int, default=1, help="mutants at a time")
    parser.add_argument("--report", type=Path, help="by default in bench/results")
    options = parser.parse_args()
    name = "_".join(["mutate", *filter(None, [options.target])])
    options.report = options.report or ROOT / "bench" / "results" / f"{name}.md"
    _prepare()
    table = tomllib.loads((ROOT / "tools" / "mutate.toml").read_text())
    suites = [Suite(target) for target in _targets(table, options.target)]
    drawn = _drawn(suites, options.mutants, options.seed)
    verdicts = _known(suites)
    left = [each for each in drawn if each[1].key not in verdicts]
    print(f"{len(drawn)} mutants, {len(left)} of them to be judged", flush=True)
    with multiprocessing.get_context("fork").Pool(options.jobs) as pool:
        for k, verdict in enumerate(pool.imap_unordered(_judged, left), 1):
            verdicts[verdict["key"]] = verdict
            with (OUT / "verdicts.jsonl").open("a") as file:
                file.write(json.dumps(verdict) + "\n")
            print(
                f"{k}/{len(left)} {'SURVIVES' if verdict['survived'] else 'killed'} "
                f"{verdict['change']}",
                flush=True,
            )
    write_report(options, table, [mutant for _, mutant in drawn], verdicts)


def _judged(each: tuple[Suite, Mutant]) -> dict:
    suite, mutant = each
    return suite.judge(mutant)


if __name__ == "__main__":
    main()
