# SPDX-License-Identifier: Apache-2.0
"""The command prints results on stdout, progress on stderr, and refuses errors in one line."""

import csv
import json
import subprocess
import sys

import pytest

from fiber_core.problem import load_problem
from fiber_positioners import study
from fiber_positioners.command import main, plan
from fiber_positioners.command.arguments import arm_pairs, numbers, whole_numbers
from fiber_recording import load_recording


def test_plan_prints_one_json_line_and_writes_its_files(tmp_path, capsys, result):
    out = tmp_path / "field"
    arguments = ["plan", "--preset", "desi", "--robots", "37", "--seed", "1", "--out", str(out)]
    assert main([*arguments, "--player", str(tmp_path / "player.html")]) == 0
    printed = capsys.readouterr()
    report = json.loads(printed.out)
    assert printed.out.count("\n") == 1 and list(report) == list(result.report)
    assert report["reached"] == 37 and report["certified"]
    assert "robots are moving" in printed.err
    assert sorted(path.name for path in out.iterdir()) == [
        "outcomes.ecsv", "plan.npz", "player.html", "problem.npz", "recording.npz", "report.json",
    ]  # fmt: skip
    assert load_problem(out / "problem.npz").plane.n == 37
    assert (tmp_path / "player.html").stat().st_size > 50_000
    assert (out / "player.html").read_bytes() == (tmp_path / "player.html").read_bytes()
    lines = (out / "outcomes.ecsv").read_text().splitlines()
    assert len([line for line in lines if not line.startswith("#")]) == 1 + 37


def test_a_folder_that_cannot_be_made_is_refused_before_the_work(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(plan, "reconfigure", lambda *_, **__: pytest.fail("work was begun"))
    (tmp_path / "file").touch()
    arguments = ["plan", "--robots", "7", "--out", str(tmp_path / "file/below")]
    assert main(arguments) != 0
    error = capsys.readouterr().err.strip()
    assert error.count("\n") == 0 and str(tmp_path / "file/below") in error


def test_plan_takes_a_problem_file_and_a_table_of_targets(tmp_path, capsys, result):
    result.save(tmp_path, recording=False)
    x, y = result.problem.targets[3]
    (tmp_path / "targets.csv").write_text(f"id,x_mm,y_mm\n3,{x},{y}\n")
    arguments = ["plan", "--problem", str(tmp_path / "problem.npz")]
    assert main([*arguments, "--targets", str(tmp_path / "targets.csv"), "--cold"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["robots"] == 37 and report["asked"] == report["reached"] == 1


def test_plan_takes_the_spacing_of_targets(tmp_path, capsys):
    (tmp_path / "targets.csv").write_text("id,x_mm,y_mm\n0,-1.8,-3.118\n1,-3.4,-5.889\n")
    arguments = ["plan", "--robots", "7", "--targets", str(tmp_path / "targets.csv"), "--cold"]
    for more, refused in (([], 0), (["--spacing", "4"], 1), (["--planner", "dnf_arms"], 1)):
        assert main([*arguments, *more]) == 0
        reasons = json.loads(capsys.readouterr().out)["reasons"]
        assert reasons.get("target_too_close", 0) == refused, more
    assert main([*arguments, "--spacing", "-1"]) == 2
    assert "'-1' is less than 0" in capsys.readouterr().err


def test_plan_reads_files_of_an_instrument_and_writes_all_robots(tmp_path, capsys):
    layout, starts = tmp_path / "layout.csv", tmp_path / "starts.csv"
    layout.write_text(
        "LOCATION;X_MM;Y_MM;ARM_THETA_MM;ARM_PHI_MM;nonfunctional;colour\n"
        "7;0;0;3;3;no;red\n5;10.4;0;3;3;no;red\n6;20.8;0;3;3;yes;blue\n"
    )
    starts.write_text("id,theta_deg,phi_deg\n5,10,150\n6,20,160\n7,30,140\n")
    (tmp_path / "targets.csv").write_text("id,x_mm,y_mm\n7,1.5,4\n5,,\n")
    arguments = [f"--{name}={tmp_path / name}.csv" for name in ("layout", "starts", "targets")]
    table = tmp_path / "results.csv"
    assert main(["plan", *arguments, "--results", str(table), "--form", "desi", "--cold"]) == 0
    printed = capsys.readouterr()
    report = json.loads(printed.out)
    assert (report["robots"], report["asked"], report["reached"]) == (3, 1, 1)
    assert "layout.csv: 3 robots, 1 disabled; from preset desi: " in printed.err
    assert "columns not used: colour" in printed.err
    rows = {row["id"]: row for row in csv.DictReader(table.open())}
    assert [rows[i]["outcome"] for i in "567"] == ["held", "held", "reached"]
    assert float(rows["7"]["error_um"]) < 1.0 and rows["5"]["error_um"] in ("", "nan")
    assert [rows[i]["FIBERSTATUS"] for i in "567"] == ["1", "3", "0"]
    assert main(["plan", f"--layout={layout}", f"--starts={table}", "--cold"]) == 0
    capsys.readouterr()


def test_convert_writes_a_table_and_says_what_it_did(tmp_path, capsys):
    (tmp_path / "sites.csv").write_text("id,x_mm,y_mm\n1,0,0\n2,10.4,0\n")
    own = tmp_path / "own.ecsv"
    assert main(["convert", str(tmp_path / "sites.csv"), str(own), "--preset", "desi"]) == 0
    assert capsys.readouterr().out.startswith("sites.csv: 2 robots, 0 disabled; from preset desi")
    assert own.exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["plan", "--robts", "3"], "unknown option --robts, similar is --robots"),
        (["plan", "extra"], "unknown argument extra"),
        (["plan", "--robots"], "--robots: expected one argument"),
        (["plan", "--robots", "0"], "'0' is not a positive whole number"),
        (["plan", "--robots", "many"], "'many' is not a number"),
        (["plan", "--planner", "quickest"], "'quickest'"),
        (["plan", "--layout", "missing.csv"], "missing.csv"),
        (["plan", "--problem", "missing.npz"], "missing.npz"),
        (["plan", "--starts", "missing.csv"], "there is no file missing.csv"),
        (["plan", "--results", "results.xlsx"], "a table is written as"),
        (["plan", "--results", "absent/results.csv"], "there is no folder absent"),
        (["plan", "--robots", "3", "--results", "r.par", "--form", "sdss_v"], "the plane has none"),
        (["plan", "--form", "desi"], "--form tells columns of --results"),
        (["convert", "missing.csv", "own.csv"], "there is no file missing.csv"),
        (["convert", "missing.csv"], "TABLE"),
        (["study", "--pitch", "9;10"], "'9;10' is not a number"),
        (["study", "--pitch", "9:10"], "not a range BEGIN:END:STEP"),
        (["study", "--pitch", "10:9:1"], "END must be at least BEGIN"),
        (["study", "--pitch", "-1"], "pitch must be positive, got -1 mm"),
        (["study", "--robots", "3.5"], "3.5 is not a whole number"),
        (["study", "--disabled", "2"], "0..1, got 2"),
        (["study", "--planner", "direct,quickest"], "'quickest' is not one of"),
        (["study", "--preset", "desi_outlines", "--arms", "4"], "do not scale"),
        (["study", "--seeds", "0"], "'0' is not a positive whole number"),
        (["player", "missing.npz"], "missing.npz"),
        (["players"], "'players'"),
        ([], "COMMAND"),
    ],
)
def test_an_error_is_one_line_on_stderr_with_exit_code_2(arguments, said, capsys):
    assert main(arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err.count("\n") == 1
    assert printed.err.startswith("fiber-positioners") and said in printed.err


@pytest.mark.parametrize("command", ["plan", "study", "player", "convert"])
def test_help_shows_examples_and_options(command, capsys):
    assert main([command, "--help"]) == 0
    text = capsys.readouterr().out
    assert f"fiber-positioners {command}" in text and "examples:" in text
    assert "None" not in text and "==SUPPRESS==" not in text


def test_study_prints_a_table_and_writes_rows_summary_and_picture(tmp_path, capsys):
    out = tmp_path / "study"
    arguments = ["study", "--pitch", "10:11:1", "--arms", "3,3x2.5", "--robots", "7"]
    assert main([*arguments, "--seeds", "2", "--out", str(out)]) == 0
    printed = capsys.readouterr()
    lines = printed.out.splitlines()
    assert "makespan / bound" in lines[0] and len(lines) == 1 + 4 + 1
    assert printed.err.count("reached in") == 8
    with open(out / "study.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["pitch_mm"] for row in rows] == ["10.0"] * 4 + ["11.0"] * 4
    assert [row["seed"] for row in rows] == ["1", "2"] * 4
    assert all(row["reached"] == "7" and row["error"] == "" for row in rows)
    told = json.loads((out / "study.json").read_text())
    assert len(told["cases"]) == 4 and len(told["rows"]) == 8
    assert told["cases"][1]["arm_phi_mm"] == 2.5
    assert (out / "study.png").read_bytes().startswith(b"\x89PNG")


def test_an_interrupted_study_keeps_the_fields_that_are_finished(tmp_path, capsys, monkeypatch):
    carried_out, run = [], study.Case.run

    def interrupted(case, seed):
        if len(carried_out) == 3:
            raise KeyboardInterrupt
        carried_out.append(seed)
        return run(case, seed)

    monkeypatch.setattr(study.Case, "run", interrupted)
    out = tmp_path / "study"
    arguments = ["study", "--pitch", "10,11", "--robots", "7", "--seeds", "2", "--out", str(out)]
    assert main(arguments) == 130
    assert "3 of 4 fields are finished" in capsys.readouterr().err
    with open(out / "study.csv", newline="") as file:
        assert len(list(csv.DictReader(file))) == 3
    assert len(json.loads((out / "study.json").read_text())["rows"]) == 3
    assert (out / "study.png").exists()


def test_player_writes_a_page_beside_the_recording(tmp_path, capsys, result):
    result.save(tmp_path)
    assert main(["player", str(tmp_path / "recording.npz")]) == 0
    page = tmp_path / "player.html"
    assert capsys.readouterr().out.strip() == str(page) and page.stat().st_size > 50_000
    assert load_recording(tmp_path / "recording.npz").problem.plane.n == 37


def test_the_module_runs_as_the_command():
    done = subprocess.run(
        [sys.executable, "-m", "fiber_positioners", "plan", "--robts"],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 2 and "unknown option --robts" in done.stderr


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("5", [5.0]),
        ("5.0,5.5", [5.0, 5.5]),
        ("5:7:0.5", [5.0, 5.5, 6.0, 6.5, 7.0]),
        ("5:6.9:0.5", [5.0, 5.5, 6.0, 6.5]),
        ("0:0.3:0.1", [0.0, 0.1, 0.2, 0.3]),
        ("1, 2:3:1, 1", [1.0, 2.0, 3.0]),
    ],
)
def test_lists_and_ranges_of_numbers(text, values):
    assert numbers(text) == values


def test_whole_numbers_and_pairs_of_arms():
    assert whole_numbers("100:300:100") == [100, 200, 300]
    assert arm_pairs("3x2.5,4,5:6:1") == [(3.0, 2.5), (4.0, 4.0), (5.0, 5.0), (6.0, 6.0)]
