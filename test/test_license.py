# SPDX-License-Identifier: Apache-2.0
"""Every source file names the license."""

import spdx


def test_every_source_file_names_the_license():
    assert spdx.missing() == [], "run python3 tools/spdx.py"


def test_a_file_without_the_line_is_found(tmp_path, monkeypatch):
    monkeypatch.setattr(spdx, "ROOT", tmp_path)
    names = ["a.py", "b.js", "c.md", "d.py", "e.sh"]
    (tmp_path / "a.py").write_text("x = 1\n")
    (tmp_path / "b.js").write_text(f"// {spdx.LICENSE_LINE}\n")
    (tmp_path / "c.md").write_text("# Title\n")
    (tmp_path / "d.py").write_text("")
    (tmp_path / "e.sh").write_text("#!/bin/sh\necho\n")
    spdx.subprocess.run(["git", "init", "-q"], cwd=tmp_path, check=True)
    assert spdx.missing() == ["a.py", "e.sh"]
    monkeypatch.setattr("sys.argv", ["spdx.py"])
    assert spdx.main() == 0 and spdx.missing() == []
    assert (tmp_path / "e.sh").read_text() == f"#!/bin/sh\n# {spdx.LICENSE_LINE}\necho\n"
    assert set(names) <= {path.name for path in tmp_path.iterdir()}
