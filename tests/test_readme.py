"""The README's example runs as printed."""

import re
from pathlib import Path

import numpy as np

README = (Path(__file__).resolve().parents[1] / "README.md").read_text(encoding="utf-8")


EXAMPLES = re.findall(r"```python\n(.*?)```", README, re.S)


def test_the_static_example(tmp_path, monkeypatch, capsys):
    """The lift of a wing on a finer mesh comes back: its moment within 3 %, its distribution within its band."""
    from structures import ForwardModel, bases, beams, sensors

    places = np.linspace(0, 6, 121)
    lift = 900 * np.sqrt(np.maximum(1 - (places / 6) ** 2, 0.0))
    wing = beams.cantilever(length=6.0, EI=lambda x: 9e5 * (1 - x / 12) ** 3, mass_per_length=20.0, elements=120)
    at = (0.2, 1.0, 2.0, 3.0, 4.0, 5.0)
    gauges = [sensors.StrainGauge(at=x, fibre=0.08 * (1 - x / 12), label=f"g{x}") for x in at]
    clean = ForwardModel(wing, gauges, bases.hats(wing, [places])).static() @ lift
    monkeypatch.chdir(tmp_path)
    scope: dict = {"strains": clean + 1.5e-6 * np.random.default_rng(0).standard_normal(len(at))}
    exec(compile(EXAMPLES[4], "README.md", "exec"), scope)
    found = scope["lift"]
    true = 900 * np.sqrt(1 - (np.arange(0.125, 6, 0.25) / 6) ** 2)
    moment = next(r.value for r in found.resultants if r.name == "M")
    assert abs(moment / np.trapezoid(lift * places, places) - 1) < 0.03
    assert np.mean(np.abs(found.load - true) < 2 * found.std) > 0.8
    assert "M " in capsys.readouterr().out
    assert Path("picard.png").stat().st_size > 10_000


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
    dt, finer, samples = 1 / 20e3, 4, 1200
    t = np.arange(samples * finer) * dt / finer
    force = np.where((t > 0.02) & (t < 0.0215), 200 * np.sin(np.pi * (t - 0.02) / 0.0015), 0.0)
    clean = truth.predict(force, dt / finer)[::finer, 0]
    noisy = clean + 0.005 * np.std(clean) * np.random.default_rng(0).standard_normal(samples)
    monkeypatch.chdir(tmp_path)
    table = np.column_stack([t[::finer], noisy])
    np.savetxt("log.csv", table, delimiter=",", header="time [s],12+Z [m/s^2]", comments="", fmt="%.10g")
    scope: dict = {}
    exec(compile(EXAMPLES[0], "README.md", "exec"), scope)
    estimate = scope["estimate"]
    peak = estimate.peaks[0]
    assert abs(peak.value - 200) < 0.1 * 200
    assert abs(peak.value - 200) < 3 * peak.std
    out = capsys.readouterr().out
    assert "model not verified" in out
    assert "grade A" in out
    loud = force[::finer]
    assert np.linalg.norm(estimate.load[:, 0] - loud) < 0.1 * np.linalg.norm(loud)
    assert Path("impact.html").stat().st_size > 10_000
    short = table[300:700]  # the same example on 20 ms around the hit
    np.savetxt("log.csv", short, delimiter=",", header="time [s],12+Z [m/s^2]", comments="", fmt="%.10g")
    exec(compile(EXAMPLES[1], "README.md", "exec"), scope)
    for name in ("push", "hits"):
        assert abs(scope[name].peaks[0].value - 200) < 0.15 * 200, name
    assert scope["push"].load.min() >= 0
    assert "SparseDeconvolution: the load looks impulsive" in capsys.readouterr().out
    assert "place" in scope["place"].summary()


def test_the_frequency_example(tmp_path, monkeypatch, capsys):
    """Universal files of a beam under a random force: its power comes back, the kept-out sensor is predicted."""
    from scipy.signal import butter, lfilter

    from structures import ForwardModel, beams, damping, loads, sensors
    from tests.structures.uff_made import frfs, text58, units

    beam = beams.simply_supported(
        length=2.0, section=beams.Section.rectangle(0.05, 0.01), material=beams.materials.steel, elements=40,
        damping=damping.Modal(0.03),
    )  # fmt: skip
    nodes, dt, fine = (5, 12, 14, 31), 1 / 1024, 8
    seen = [sensors.Accelerometer(f"{n}+Z") for n in nodes]
    model = ForwardModel(beam, seen, [loads.Point("13+Z")], modes=6, residual=False)
    rng = np.random.default_rng(0)
    filtered = butter(2, [8 * 2 * dt / fine, 250 * 2 * dt / fine], "band")
    force = 20 * lfilter(*filtered, rng.standard_normal(20_000 * fine))
    y = model.predict(force[:, None], dt / fine)[::fine]
    y += 0.01 * y.std() * rng.standard_normal(y.shape)
    monkeypatch.chdir(tmp_path)
    f = np.arange(1, 512) * 0.5
    H = model.frf(f)
    Path("frfs.uff").write_bytes(units() + frfs(H, [(n, 3) for n in nodes], [(13, 3)], start=0.5, step=0.5))
    step = {"function": 1, "abscissa": ("time", "s"), "step": dt, "denominator": (0, "NONE")}
    logs = [text58(y[:, i], response=("NONE", n, 3), reference=("NONE", 0, 0), **step) for i, n in enumerate(nodes)]
    Path("operating.uff").write_bytes(units() + b"".join(logs))
    scope: dict = {"read": __import__("loadid").read}
    exec(compile(EXAMPLES[2], "README.md", "exec"), scope)
    found = scope["sources"]
    inside = (found.axis.values > 20) & (found.axis.values < 200)
    from structures import cross_spectra

    known = cross_spectra(force[::fine, None], dt, segment=2048)
    truth = np.interp(found.axis.values, known.frequencies, known.autospectra[:, 0])
    assert abs(found.load[inside].sum() / truth[inside].sum() - 1) < 0.05
    assert "LID-W412" not in found.codes
    assert found.facts["held_out"][0].startswith("14+Z")
    assert "peak 13+Z" in capsys.readouterr().out
    assert "not tell" in found.summary(details=True)
    assert found.grade.letter < "D"
    assert Path("sources.png").stat().st_size > 10_000


def test_the_tracking_example(tmp_path, monkeypatch, capsys):
    """A gusty load on a mast, simulated finer, is followed within its band from a saved commissioning record on."""
    from loadid.priors import Matern32
    from structures import ForwardModel, beams, damping, loads, sensors

    mast = beams.cantilever(length=12.0, EI=4e6, mass_per_length=60.0, damping=damping.Modal(0.02))
    seen = [sensors.Accelerometer("20+Z"), sensors.Accelerometer("11+Z"), sensors.StrainGauge(at=0.5, fibre=0.1)]
    model = ForwardModel(mast, seen, [loads.Point("20+Z")], modes=6)
    dt, fine, samples = 0.005, 8, 5000
    rng = np.random.default_rng(0)
    step = Matern32(500.0, 0.3).discrete(dt / fine)
    z, force = np.zeros(2), np.empty((samples * fine, 1))
    for k, w in enumerate(rng.standard_normal((len(force), 2))):
        force[k] = step.H @ z
        z = step.F @ z + step.LQ @ w
    y = model.predict(force, dt / fine)[::fine]
    y += 0.01 * y.std(axis=0) * rng.standard_normal(y.shape)
    monkeypatch.chdir(tmp_path)
    head = f"time [s],20+Z [m/s^2],11+Z [m/s^2],{seen[2].label} [m/m]"
    for name, part in (("commissioning.csv", slice(0, 3000)), ("today.csv", slice(3000, None))):
        table = np.column_stack([np.arange(len(y[part])) * dt, y[part]])
        np.savetxt(name, table, delimiter=",", header=head, comments="", fmt="%.10g")
    scope: dict = {}
    exec(compile(EXAMPLES[3], "README.md", "exec"), scope)
    assert abs(scope["load"].item() - force[-fine].item()) < 4 * scope["std"].item()
    assert "NIS per channel" in capsys.readouterr().out
    assert Path("mast.h5").stat().st_size > 1000
    _the_tracking_commands(scope, force[3000 * fine :: fine])


def _the_tracking_commands(scope, force):
    """The two command lines below the example, on the files of the example."""
    from loadid import cli

    saving, *others = re.findall(r"`(model\.save\([^`]*\))`", README)
    assert not others
    exec(saving, {"model": scope["model"]})
    commands = [line.split() for line in re.findall(r"`loadid (track [^`]*)`", README)]
    assert len(commands) == 2
    for words in commands:
        assert cli.main([*words, "--idle", "0"]) == 0
        table = np.loadtxt(words[words.index("--out") + 1], delimiter=",", skiprows=1)
        off = (table[200:, 1] - force[200:, 0]) / table[200:, 2]
        assert np.mean(np.abs(off) < 1.96) > 0.85
        assert np.linalg.norm(table[200:, 1] - force[200:, 0]) < 0.1 * np.linalg.norm(force[200:])


def test_the_two_commands_stand_on_their_own_lines():
    lines = [line.strip() for line in README.splitlines()]
    assert "python -m pip install -e . && loadid demo" in lines
    assert 'python -m pip install -e ".[test]" && python -m pytest' in lines


def test_links_and_pictures_exist():
    root = Path(__file__).resolve().parents[1]
    for target in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (root / target).exists(), target


def test_the_tactile_example(tmp_path, monkeypatch, capsys):
    """A press of 1 N with 0.25 N of shear, photographed, comes back within 5 %."""
    from tactile import Layer, Press, View
    from tactile.vision._images import Scene, grid

    layer, dots = Layer(3e-3, 147e3, 0.3223), grid(17, 20, 0.85e-3)
    view = View.camera(focal=640, centre=(320, 240), distance=25e-3, depth=3e-3, gamma=1.4)
    rest, scene = np.column_stack([dots, np.zeros(len(dots))]), Scene(radius=0.22e-3)
    line = [(np.arange(n) - (n - 1) / 2) * 1e-4 for n in (180, 160)]
    places = np.array(np.meshgrid(*line)).reshape(2, -1).T
    images, depths, rng = [], [], np.random.default_rng(0)
    for k, share in enumerate([0, 0, 0, 0, 0, 0.3, 0.6, 0.8, 1.0]):
        press = Press(radius=2.2e-3, force=share, shear=(0.25 * share, 0.0))
        images.append(scene.photograph(view, rest + press.displacement(layer, dots), seed=k))
        z = press.displacement(layer, places)[:, 2].reshape(160, 180)
        depths.append(z + 1e-5 * rng.standard_normal(z.shape))
    monkeypatch.chdir(tmp_path)
    np.save("press.npy", np.array(images))
    np.save("depth.npy", np.array(depths))
    scope: dict = {}
    example = next(e for e in EXAMPLES if "from tactile" in e)
    exec(compile(example.replace('frames("press")', 'frames("press.npy")'), "README.md", "exec"), scope)
    force = scope["force"]
    assert np.allclose(force.resultant().value, [0.25, 0.0, -1.0], atol=0.05)
    assert abs(force.contact().radius / 2.2e-3 - 1) < 0.1
    assert "N m" not in capsys.readouterr().err
    assert Path("map.h5").stat().st_size > 10_000
