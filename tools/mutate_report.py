# SPDX-License-Identifier: Apache-2.0
"""The report of a mutation run, a Markdown file: the share killed by module, and the survivors."""

from argparse import Namespace
from collections import defaultdict

from mutants import Mutant

__all__ = ["write_report"]

_HEAD = """Mistakes planted one at a time, and the share that the tests notice: `{command}`.

A mutant is a comparison shifted or turned round, another operator, number or extreme, a sign or a
statement left out ([tools/mutants.py](../../tools/mutants.py)). Equivalent mutants, each with its
reason below, are not counted.

| module | mutants | equivalent | killed | survive | share killed |
|---|---|---|---|---|---|
"""


def write_report(
    options: Namespace, config: dict, drawn: list[Mutant], verdicts: dict[str, dict]
) -> None:
    """Write the report and print the share killed.

    Args:
        options: options of the command.
        config: tools/mutate.toml.
        drawn: mutants of the sample.
        verdicts: verdict on each, by key.
    """
    reasons = {
        (e["module"], change): e["reason"]
        for e in config.get("equivalent", [])
        for change in e["changes"]
    }
    modules: dict[str, list[Mutant]] = defaultdict(list)
    for mutant in sorted(drawn, key=lambda each: (each.module, each.line)):
        modules[mutant.module].append(mutant)
    command = " ".join(
        ["make mutate"]
        + [
            f"{name.upper()}={value}"
            for name in ("target", "mutants", "seed")
            if (value := getattr(options, name))
        ]
    )
    rows, survivors, equivalents, total = "", "", "", [0, 0, 0]
    for module, mutants in modules.items():
        alive = [mutant for mutant in mutants if verdicts[mutant.key]["survived"]]
        same = [mutant for mutant in alive if (mutant.path.stem, mutant.change) in reasons]
        counts = [len(mutants), len(same), len(mutants) - len(alive)]
        total = [a + b for a, b in zip(total, counts)]
        rows += _row(module, *counts)
        for mutant in alive:
            line = f"- {mutant.path.stem}:{mutant.line} `{mutant.change}`"
            if mutant in same:
                equivalents += f"{line}: {reasons[mutant.path.stem, mutant.change]}\n"
            else:
                survivors += f"{line}\n"
    rows += _row("all", *total)
    text = _HEAD.format(command=command) + rows
    text += f"\n## Survivors\n\n{survivors or 'None.'}\n"
    text += f"\n## Equivalent\n\n{equivalents or 'None.'}\n"
    options.report.write_text(text.rstrip() + "\n")
    print(rows)


def _row(name: str, mutants: int, equivalent: int, killed: int) -> str:
    counted = mutants - equivalent
    share = f"{100 * killed / counted:.1f} %" if counted else ""
    return f"| {name} | {mutants} | {equivalent} | {killed} | {counted - killed} | {share} |\n"
