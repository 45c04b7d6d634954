"""Every block of docs/vibration.md runs as printed, one after the other, in an empty folder."""

import re
from pathlib import Path

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "vibration.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.S)


def test_the_page_runs_as_printed(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    scope: dict = {}
    for i, block in enumerate(BLOCKS):
        exec(compile(block, f"docs/vibration.md, block {i}", "exec"), scope)
    printed = capsys.readouterr().out
    assert len(BLOCKS) == 6
    assert "W317" in {f.code.removeprefix("LID-") for f in scope["drives"].flags}
    assert scope["free"].rms_error < scope["held"].rms_error
    assert scope["held"].bound
    assert "foot+Z" in printed
    assert max(scope["paths"].held_out.comparison.error) < 0.1
    assert {p.name for p in tmp_path.iterdir()} == {"drives.png", "drives.h5", "paths.png"}
