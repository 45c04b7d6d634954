"""The README's example runs as printed."""

import re
from pathlib import Path

import numpy as np

README = (Path(__file__).resolve().parents[1] / "README.md").read_text(encoding="utf-8")


def example() -> str:
    (code,) = re.findall(r"```python\n(.*?)```", README, re.S)
    return code


def test_the_python_example(tmp_path, monkeypatch, capsys):
    """A hit of 200 N, simulated with a finer mesh, comes back within its band."""
    from structures import ForwardModel, beams, damping, loads, sensors

    beam = beams.cantilever(
        length=0.3,
        section=beams.Section.rectangle(0.04, 0.01),
        material=beams.materials.steel,
        damping=damping.Modal(0.02),
        elements=80,
    )
    truth = ForwardModel(beam, [sensors.Accelerometer("24+Z")], [loads.Point("62+Z")], modes=20)
    dt, finer, samples = 1 / 20e3, 4, 10_000
    t = np.arange(samples * finer) * dt / finer
    force = np.where((t > 0.02) & (t < 0.0215), 200 * np.sin(np.pi * (t - 0.02) / 0.0015), 0.0)
    clean = truth.predict(force, dt / finer)[::finer, 0]
    noisy = clean + 0.005 * np.std(clean) * np.random.default_rng(0).standard_normal(samples)
    monkeypatch.chdir(tmp_path)
    table = np.column_stack([t[::finer], noisy])
    np.savetxt("log.csv", table, delimiter=",", header="time [s],12+Z [m/s^2]", comments="", fmt="%.10g")
    scope: dict = {}
    exec(compile(example(), "README.md", "exec"), scope)
    estimate = scope["estimate"]
    peak = estimate.peaks[0]
    assert abs(peak.value - 200) < 0.1 * 200
    assert abs(peak.value - 200) < 3 * peak.std
    assert "forward model not verified" in capsys.readouterr().out
    assert Path("impact.html").stat().st_size > 10_000


def test_the_two_commands_stand_on_their_own_lines():
    lines = [line.strip() for line in README.splitlines()]
    assert "python -m pip install -e . && loadid demo" in lines
    assert 'python -m pip install -e ".[test]" && python -m pytest' in lines


def test_links_and_pictures_exist():
    root = Path(__file__).resolve().parents[1]
    for target in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (root / target).exists(), target
