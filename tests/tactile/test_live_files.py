"""What a running sensor leaves behind: its state, its recordings, through kills; and what others on the machine see."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import struct
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from structures.errors import InputError
from tactile import ContactLaw, Eye, GelSlim, Markers, MultilayerPad
from tactile.live import LineServer, Live, LiveFrame, Recording, State, Viewer, message, point_cloud, replay, wrench
from tactile.live._messages import line
from tactile.live._recordings import Hdf5Part, parts
from tactile.live._state import state_of
from tactile.vision._images import Scene

from .rigs import NOISE, fresh, markers, motion, pad
from .scenes import camera
from .test_live import RATE, resting, run, sliding_frames

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def day(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[LiveFrame]]:
    """A run with a dead frame and a slide, recorded in both formats, with its state."""
    folder = tmp_path_factory.mktemp("live")
    pytest.importorskip("mcap")
    frames = [*resting(6), None, *sliding_frames(0.4, 45)]
    given = {"state": folder / "state.h5", "record": [folder / "run.h5", folder / "run.mcap"]}
    return folder, run(frames, quiet=None, **given)[1]


# -- state ------------------------------------------------------------------------------------------------------------
def test_a_state_is_taken_up(day: tuple[Path, list[LiveFrame]]) -> None:
    folder, found = day
    state = State.read(folder / "state.h5")
    assert state.number == found[-1].number == 52
    assert dict(state.counts) == {"frames": 52, "maps": 51, "dead": 1, "dropped": 0, "unrecorded": 0}
    assert state.lam == pytest.approx(0.01)
    shutil.copy(folder / "state.h5", folder / "other.h5")
    live, more = run(resting(4), quiet=None, state=folder / "other.h5")
    assert [f.number for f in more] == [53, 54, 55, 56]
    assert live.counts["frames"] == 56
    before = found[-1].slip
    assert before is not None
    assert live.friction == before.friction
    assert State.read(folder / "other.h5").number == 56


def test_a_zero_outlives_a_start_into_a_load(tmp_path: Path) -> None:
    shifted = np.array([20e-6, 0, 0])
    _, first = run(resting(70, 0, shifted), quiet=0.5, state=tmp_path / "s.h5")
    assert abs(first[0].map.resultant().value[0]) > 0.03
    live, found = run([motion(k) + shifted for k in range(5)], quiet=0.5, state=tmp_path / "s.h5")
    like = fresh().estimate(motion()).resultant().value
    assert found[0].map.resultant().value == pytest.approx(like, abs=5e-3)
    assert live._rest.anchor == pytest.approx(0.0)  # the rest is held against the first one still


def test_a_state_of_another_pad_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "s.h5"
    state_of(fresh(), 7, {}, np.zeros(fresh().offset.shape), {}).write(path)
    moved = MultilayerPad(pad(), Markers(markers() + 1e-6, NOISE, "XYZ"), choice=0.01)
    with pytest.raises(InputError, match=r"markers of the state are others.*the same places.*rebuilt"):
        Live(moved, [], state=path)
    with pytest.raises(InputError, match="another axes"):
        Live(fresh("XY"), [], state=path)
    with pytest.raises(InputError, match="another pad"):
        Live(MultilayerPad(pad(4), Markers(markers(), NOISE, "XYZ"), choice=0.01), [], state=path)
    with pytest.raises(InputError, match="another sensor"):
        Live(GelSlim(pad(), Markers(markers(), NOISE, "XYZ")), [], state=path)
    data = bytearray(path.read_bytes())
    data[-40] ^= 1
    path.write_bytes(bytes(data))
    with pytest.raises(InputError, match="damaged"):
        Live(fresh(), [], state=path)


def test_an_eye_is_rebuilt_with_the_same_markers(tmp_path: Path) -> None:
    scene = Scene(size=(240, 320), radius=0.22e-3, noise=2.0)
    view = camera()
    dots = np.column_stack([a.ravel() for a in np.meshgrid(np.linspace(-4e-3, 4e-3, 9), np.linspace(-3e-3, 3e-3, 7))])
    view = type(view).camera(focal=500, centre=(160, 120), distance=20e-3, depth=3e-3, gamma=1.4)
    still = [scene.photograph(view, dots, seed=k) for k in range(5)]
    eye = Eye(view, still[0], unloaded=still[1:], size=pad().size, gate=0.35)
    here = MultilayerPad(pad(), eye=eye, choice=0.01)
    state_of(here, 1, {}, here.offset, {}).write(tmp_path / "s.h5")
    state = State.read(tmp_path / "s.h5")
    again = state.rebuilt(view, pad().size)
    assert np.array_equal(again.markers, eye.markers)
    assert np.array_equal(again.noise, eye.noise)
    assert (again.tracker.gate, again.tracker.detector) == (0.35, eye.tracker.detector)
    state.require(MultilayerPad(pad(), eye=again, choice=0.01), "s.h5")
    now = scene.photograph(view, dots + 30e-6, seed=9)
    assert again.read(now)[0] == pytest.approx(eye.read(now)[0], abs=1e-12)
    with pytest.raises(InputError, match="had no eye"):
        state_of(fresh(), 1, {}, fresh().offset, {}).rebuilt(view)


# -- recordings -------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", ["run.h5", "run.mcap"])
def test_a_recording_gives_the_same_maps(day: tuple[Path, list[LiveFrame]], name: str) -> None:
    folder, found = day
    again = list(replay(folder / name, speed=None))
    assert len(again) == len(found)
    for one, like in zip(again, found, strict=True):
        assert (one.number, one.time, one.touched, one.on) == (like.number, like.time, like.touched, like.on)
        assert one.events == like.events
        assert np.array_equal(one.motion, like.motion)
        scale = np.abs(like.map.load).max()
        np.testing.assert_allclose(one.map.load, like.map.load, atol=1e-7 * scale)
        np.testing.assert_allclose(one.map.std, like.map.std, rtol=1e-7)
        a, b = one.map.resultant(), like.map.resultant()
        np.testing.assert_allclose(a.value, b.value, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(a.std, b.std, rtol=1e-12)
        assert one.map.codes == like.map.codes
        assert one.map.facts["lost"] == like.map.facts["lost"]
        assert np.array_equal(one.map.contact().mask, like.map.contact().mask)
    slid, told = again[-1].slip, found[-1].slip
    assert slid is not None
    assert told is not None
    assert slid.friction.value == pytest.approx(told.friction.value, rel=1e-5)
    assert np.allclose(again[-1].map.forces(), found[-1].map.forces(), rtol=1e-5, atol=1e-12)


def test_a_recording_is_played_at_any_speed(day: tuple[Path, list[LiveFrame]]) -> None:
    folder, found = day
    span = found[-1].time - found[0].time
    for speed in (2.0, 8.0):
        start = time.monotonic()
        assert len(list(replay(folder / "run.h5", speed=speed))) == len(found)
        took = time.monotonic() - start
        assert took > 0.95 * span / speed
    for wrong in (0, -1, np.nan):
        with pytest.raises(InputError, match="speed"):
            replay(folder / "run.h5", speed=wrong)


def test_what_is_no_recording_is_refused(day: tuple[Path, list[LiveFrame]], tmp_path: Path) -> None:
    folder, _ = day
    for name, match in (("state.h5", "cannot be read"), ("none.h5", "no such file"), ("a.csv", "no kind")):
        with pytest.raises(InputError, match=match):
            list(replay(folder / name, speed=None))
    (tmp_path / "bad.mcap").write_bytes(b"\x89MCAP0\r\n" + b"\0" * 100)
    with pytest.raises(InputError, match="cannot be read"):
        list(replay(tmp_path / "bad.mcap", speed=None))
    with pytest.raises(InputError, match="no kind of recording"):
        Recording(tmp_path / "a.bag")
    with pytest.raises(InputError, match="folder does not exist"):
        Recording(tmp_path / "none" / "a.h5")


def test_a_recording_that_was_cut_is_read_up_to_there(day: tuple[Path, list[LiveFrame]], tmp_path: Path) -> None:
    folder, found = day
    whole = (folder / "run.mcap").read_bytes()
    for share in (0.3, 0.5, 0.9):
        (tmp_path / "run.mcap").write_bytes(whole[: int(share * len(whole))])
        again = list(replay(tmp_path / "run.mcap", speed=None))
        assert 0 < len(again) < len(found)
        assert again[-1].number == found[len(again) - 1].number


@pytest.mark.parametrize("kind", [".h5", ".mcap"])
def test_a_long_recording_has_parts(
    day: tuple[Path, list[LiveFrame]], kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tactile.live._recordings.PART", 8)
    _, found = day
    for half in (found[:20], found[20:]):  # two runs
        made = Recording(tmp_path / f"a{kind}")
        for frame in half:
            made.append(frame)
        made.close()
    Recording(tmp_path / f"a{kind}").close()  # a run without a frame leaves no part
    names = [p.name for p in parts(tmp_path / f"a{kind}")]
    assert names == [f"a{kind}", *(f"a-{k}{kind}" for k in range(2, 8))]
    assert [f.number for f in replay(tmp_path / f"a{kind}", speed=None)] == [f.number for f in found]


def test_images_are_kept_where_asked(tmp_path: Path) -> None:
    eye = type("Eye", (), {"read": lambda self, frame, depth: (motion(0), []), "pixel": 1e-4})()
    here = fresh()
    here.eye = eye
    images = [np.full((12, 16), k, np.uint8) for k in range(3)]
    _, found = run(images, sensor=here, quiet=None, images=True, record=tmp_path / "a.h5")
    again = list(replay(tmp_path / "a.h5", speed=None))
    for image, one, two in zip(images, found, again, strict=True):
        assert np.array_equal(one.image, image)
        assert np.array_equal(two.image, image)


def test_a_full_disk_ends_the_recording_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self: Any, frame: LiveFrame) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Hdf5Part, "append", full)
    _, found = run(resting(20), quiet=None, record=tmp_path / "a.h5")
    assert len(found) == 20
    assert [e.text for f in found for e in f.events if e.kind == "not recorded"][:1] in (
        [], [f"{tmp_path / 'a.h5'}: No space left on device"],
    )  # fmt: skip


ENDLESS = """
import itertools, sys
sys.path.insert(0, {root!r})
from tests.tactile.test_live import RATE, resting, sliding_frames
from tests.tactile.rigs import fresh
from tactile.live import Live, _loop, _recordings
_loop.CHECKPOINT = 0.1
_recordings.FLUSH = 0.02
frames = itertools.cycle([*resting(20), *sliding_frames(0.4, 30)])
live = Live(fresh(), frames, rate=RATE, quiet=0.1, state="state.h5", record=["run.h5", "run.mcap"])
for frame in live:
    print(frame.number, flush=True)
"""


def test_kills_keep_state_and_recordings(tmp_path: Path) -> None:
    pytest.importorskip("mcap")
    rng, reached = np.random.default_rng(0), 0
    env = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    for k in range(2):
        process = subprocess.Popen([sys.executable, "-c", ENDLESS.format(root=str(ROOT))], cwd=tmp_path, text=True,
                                   stdout=subprocess.PIPE, env=env)  # fmt: skip
        assert process.stdout is not None
        first = int(process.stdout.readline())
        assert first == reached + 1  # goes on where the state was
        for _ in range(100 + int(rng.integers(30))):  # at most 64 of them wait to be kept
            last = int(process.stdout.readline())
        time.sleep(float(rng.uniform(0, 0.03)))
        os.kill(process.pid, signal.SIGKILL)
        process.communicate()
        state = State.read(tmp_path / "state.h5")
        reached = state.number
        assert first <= reached
        assert last > first
        assert state.counts["frames"] >= reached
        for name in ("run.h5", "run.mcap"):
            files_ = parts(tmp_path / name)
            assert len(files_) == k + 1
            kept = [f.number for f in replay(files_[-1], speed=None)]
            assert kept[0] == first
            assert kept == list(range(first, first + len(kept)))
            assert len(kept) > 20
    assert len(list(replay(tmp_path / "run.h5", speed=None))) > 40  # all parts in turn


# -- messages ---------------------------------------------------------------------------------------------------------
def test_a_point_cloud_is_laid_out_as_the_message_says() -> None:
    found = fresh().estimate(motion())
    cloud = point_cloud(found)
    assert [(f["name"], f["offset"], f["datatype"], f["count"]) for f in cloud["fields"]] == [
        ("x", 0, 7, 1), ("y", 4, 7, 1), ("z", 8, 7, 1), ("fx", 12, 7, 1), ("fy", 16, 7, 1), ("fz", 20, 7, 1),
    ]  # fmt: skip
    assert (cloud["height"], cloud["width"], cloud["point_step"]) == (1, pad().points, 24)
    assert cloud["row_step"] == len(cloud["data"]) == 24 * pad().points
    assert cloud["is_bigendian"] is False
    assert cloud["is_dense"] is True
    points = np.array([struct.unpack_from("<6f", cloud["data"], 24 * k) for k in range(cloud["width"])])
    np.testing.assert_allclose(points[:, :3], found.nodes, rtol=1e-6)
    np.testing.assert_allclose(points[:, 3:].sum(axis=0), found.resultant().value, rtol=1e-4, atol=1e-6)
    told = wrench(found)
    assert [told["force"][a] for a in "xyz"] == found.resultant().value.tolist()
    assert [told["torque"][a] for a in "xyz"] == found.torque().value.tolist()


def test_a_line_is_strict_json(day: tuple[Path, list[LiveFrame]]) -> None:
    _, found = day
    for frame in found:
        told = json.loads(line(frame), parse_constant=lambda word: pytest.fail(word))
        assert told == json.loads(json.dumps(message(frame)))
        assert told["force"] == frame.map.resultant().value.tolist()
    touched, rest = json.loads(line(found[-1])), json.loads(line(found[0]))
    assert rest["contact"] is None
    assert rest["slip"] is None
    assert touched["contact"]["area"] > 0
    assert touched["slip"]["friction"] == pytest.approx(0.4, abs=0.05)
    assert set(touched["latency"]) == {"capture", "track", "map", "out", "total"}


def test_lines_go_to_who_listens_and_nobody_waits_for_him() -> None:
    server = LineServer(0)
    with pytest.raises(InputError, match="port cannot be had"):
        LineServer(server.port)
    with socket.create_connection(("127.0.0.1", server.port), timeout=5) as client:
        while not len(server.listeners):
            time.sleep(0.005)
        server.listeners.say("one")
        server.listeners.say("two")
        assert client.makefile().readline() == "one\n"
        start = time.monotonic()
        for _ in range(3000):
            server.listeners.say("x" * 10_000)  # which he never reads
        assert time.monotonic() - start < 3
        assert server.listeners.missed > 0
    server.close()


def test_the_node_of_the_example_fills_its_messages(
    day: tuple[Path, list[LiveFrame]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """With stand-ins for ROS 2 that hold only the fields that its messages have."""
    import importlib.util
    from types import ModuleType, SimpleNamespace

    def kind(*fields: str, **parts: Any) -> Any:
        def made(**given: Any) -> SimpleNamespace:
            assert set(given) <= {*fields, *parts}
            return SimpleNamespace(**{name: make() for name, make in parts.items()}, **given)

        return made

    header = kind(stamp=SimpleNamespace)
    cloud = {"height", "width", "fields", "is_bigendian", "point_step", "row_step", "data", "is_dense", "header"}
    stand_ins = {
        "rclpy": {}, "rclpy.node": {"Node": object}, "rclpy.qos": {"qos_profile_sensor_data": 5},
        "geometry_msgs.msg": {"Vector3": kind("x", "y", "z"),
                              "WrenchStamped": kind(header=header, wrench=SimpleNamespace)},
        "sensor_msgs.msg": {"PointCloud2": kind(*cloud), "PointField": kind("name", "offset", "datatype", "count")},
        "std_msgs.msg": {"String": kind("data")},
    }  # fmt: skip
    for name, content in stand_ins.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
    path = ROOT / "docs" / "examples" / "ros2" / "tactile_node.py"
    spec = importlib.util.spec_from_file_location("tactile_node", path)
    assert spec is not None
    assert spec.loader is not None
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    node, sent = example.TactileNode.__new__(example.TactileNode), []
    node.frame = "gel"
    node.wrench = node.field = node.events = SimpleNamespace(publish=sent.append)
    _, found = day
    node.publish(found[6])
    force, points, word = sent[:3]
    assert force.header.frame_id == "gel"
    assert force.header.stamp.sec + 1e-9 * force.header.stamp.nanosec == pytest.approx(found[6].time, abs=1e-8)
    assert vars(force.wrench.force) == wrench(found[6].map)["force"]
    assert points.data == point_cloud(found[6].map)["data"]
    assert [field.name for field in points.fields] == ["x", "y", "z", "fx", "fy", "fz"]
    assert "no image" in word.data


def test_ros_carries_its_messages(day: tuple[Path, list[LiveFrame]]) -> None:
    """The message types of ROS 2 Humble, into CDR and back by a library of its own."""
    pytest.importorskip("rosbags")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types, found = store.types, day[1][6]
    stamp = types["builtin_interfaces/msg/Time"](sec=int(found.time), nanosec=int(found.time % 1 * 1e9))
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="gel")
    told, cloud = wrench(found.map), point_cloud(found.map)
    vectors = {k: types["geometry_msgs/msg/Vector3"](**v) for k, v in told.items()}
    sent = types["geometry_msgs/msg/Wrench"](**vectors)
    kind = "geometry_msgs/msg/WrenchStamped"
    back: Any = store.deserialize_cdr(store.serialize_cdr(types[kind](header=header, wrench=sent), kind), kind)
    assert [getattr(back.wrench.force, a) for a in "xyz"] == found.map.resultant().value.tolist()
    assert back.header.frame_id == "gel"
    fields = [types["sensor_msgs/msg/PointField"](**f) for f in cloud["fields"]]
    data, kind = np.frombuffer(cloud["data"], np.uint8), "sensor_msgs/msg/PointCloud2"
    message_ = types[kind](**{**cloud, "header": header, "fields": fields, "data": data})
    back = store.deserialize_cdr(store.serialize_cdr(message_, kind), kind)
    at = back.data.reshape(back.width, back.point_step)
    starts = [f.offset for f in back.fields if f.name.startswith("f")]
    force = np.column_stack([at[:, k : k + 4].copy().view("<f4") for k in starts])
    np.testing.assert_allclose(force.sum(axis=0), found.map.resultant().value, rtol=1e-4, atol=1e-6)


# -- page -------------------------------------------------------------------------------------------------------------
@pytest.fixture
def viewer() -> Iterator[Viewer]:
    made = Viewer(0)
    yield made
    made.close()


def asked(viewer: Viewer, path: str, host: str | None = None) -> Any:
    request = urllib.request.Request(viewer.address + path, headers={} if host is None else {"Host": host})
    return urllib.request.urlopen(request, timeout=5)


def test_the_page_is_for_its_own_machine(viewer: Viewer) -> None:
    page = asked(viewer, "").read().decode()
    assert "<canvas" in page
    assert "http" not in page.replace("http-equiv", "")  # it needs nothing from elsewhere
    assert asked(viewer, "", "localhost:80").status == 200
    for path, host, code in (("", "evil.example", 403), ("pictures", "evil.example:80", 403), ("none", None, 404)):
        with pytest.raises(urllib.error.HTTPError) as refused:
            asked(viewer, path, host)
        assert refused.value.code == code
        refused.value.close()
    with pytest.raises(InputError, match="port cannot be had"):
        Viewer(int(viewer.address.rsplit(":", 1)[1].strip("/")))


def test_pictures_come_at_the_rate_of_a_browser_and_hold_what_is_drawn(
    viewer: Viewer, day: tuple[Path, list[LiveFrame]]
) -> None:
    import base64

    _, found = day
    assert json.loads(asked(viewer, "layout").read()) == {}
    viewer.show(found[-1])
    layout = json.loads(asked(viewer, "layout").read())
    cells = np.frombuffer(base64.b64decode(layout["cells"]), "<f4").reshape(-1, 2)
    assert len(cells) == pad().points
    stream = asked(viewer, "pictures")
    while not len(viewer.listeners):
        time.sleep(0.005)
    start, sent = time.monotonic(), 0
    while time.monotonic() - start < 1.0:
        viewer.show(found[-1])
        sent += 1
        time.sleep(1 / 240)
    count, size, picture = 0, 0, {}
    viewer.listeners.close()
    for raw in stream:
        if raw.startswith(b"data:"):
            count, size = count + 1, max(size, len(raw))
            picture = json.loads(raw[5:])
    assert 5 <= count <= 33 < sent
    assert size < 6000
    drawn = np.frombuffer(base64.b64decode(picture["pressure"]), np.int8) / 127 * picture["top"]
    p = found[-1].map.pressure()
    np.testing.assert_allclose(p[np.lexsort(found[-1].map.nodes[:, :2].T)], drawn[np.lexsort(cells.T)],
                               atol=0.006 * p.max())  # fmt: skip


def test_large_maps_are_thinned() -> None:
    from tactile.live._viewer import _Thinned

    x, y = np.meshgrid(np.linspace(-10e-3, 10e-3, 201), np.linspace(-5e-3, 5e-3, 101))
    places = np.column_stack([x.ravel(), y.ravel()])
    few = _Thinned(places, 64)
    assert len(few.places) <= 66 * 34
    np.testing.assert_allclose(few.mean(places[:, 0] * 2 + 1), few.places[:, 0] * 2 + 1, atol=1e-12)


@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
def test_the_script_of_the_page_is_javascript(tmp_path: Path) -> None:
    page = files("tactile.live").joinpath("page.html").read_text("utf-8")
    (tmp_path / "page.js").write_text(page.partition("<script>")[2].partition("</script>")[0])
    done = subprocess.run(["node", "--check", str(tmp_path / "page.js")], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


STAGE = """
const calls = {}, nodes = {};
const context = new Proxy({}, { get: (t, name) => (...given) => {
  calls[name] = (calls[name] || 0) + 1;
  if (given.some(v => typeof v === "number" && !Number.isFinite(v))) throw new Error(name + ": " + given);
}, set: () => true });
const made = () => ({ width: 520, height: 420, children: [], textContent: "", className: "",
  classes: new Set(), getContext: () => context, append(...c) { this.children.push(...c); },
  prepend(...c) { this.children.unshift(...c); }, replaceChildren(...c) { this.children = c; },
  get classList() { return { toggle: (n, on) => on ? this.classes.add(n) : this.classes.delete(n) }; } });
const document = { getElementById: n => nodes[n] ||= made(), createElement: made };
const fetch = async () => ({ json: async () => LAYOUT });
let turn = null, source = null;
const requestAnimationFrame = f => { turn = f; };
class EventSource { constructor() { source = this; } }
"""
ASKED = """
setTimeout(() => {
  for (const picture of PICTURES) { source.onmessage({ data: JSON.stringify(picture) }); turn(); }
  const on = lamps => [...lamps].filter(l => l.classes.has("on")).map(l => l.textContent);
  console.log(JSON.stringify({ calls, state: nodes.state.textContent, lamps: on(nodes.lamps.children),
    events: nodes.events.children.map(e => e.textContent),
    numbers: nodes.numbers.children.map(r => r.children.map(c => c.textContent).join(": ")) }));
}, 50);
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
def test_the_page_draws_what_it_is_sent(day: tuple[Path, list[LiveFrame]], tmp_path: Path) -> None:
    """On a stage that has only what the script asks of a browser, and refuses to draw what is no number."""
    from tactile.live._viewer import _Drawn

    _, found = day
    drawn = _Drawn(found[0].map)
    shown = [found[0], found[6], found[-1]]
    pictures = [{**message(frame), **drawn.picture(frame)} for frame in shown]
    page = files("tactile.live").joinpath("page.html").read_text("utf-8")
    script = page.partition("<script>")[2].partition("</script>")[0].replace('"use strict";', "")
    given = f"const LAYOUT = {json.dumps(drawn.layout)}, PICTURES = {json.dumps(pictures)};"
    (tmp_path / "stage.js").write_text(given + STAGE + script + ASKED)
    done = subprocess.run(["node", str(tmp_path / "stage.js")], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["calls"]["fillRect"] == len(shown) * pad().points
    assert told["calls"]["lineTo"] > 100
    assert told["state"] == f"frame {found[-1].number}"
    assert "touched" in told["lamps"]
    assert [text.partition(":")[0] for text in told["events"]] == ["frame 8", "frame 7"]
    force = found[-1].map.resultant()
    assert told["numbers"][2].startswith(f"Fz: {force.value[2]:+.3f} ")
    assert any(text.startswith("friction: 0.4") for text in told["numbers"])


def test_constrained_maps_go_through(tmp_path: Path) -> None:
    here = fresh(contact=ContactLaw(no_pull=True))
    _, found = run([motion(k) for k in range(4)], sensor=here, quiet=None, record=tmp_path / "a.h5")
    again = list(replay(tmp_path / "a.h5", speed=None))
    assert len(again) == len(found) == 4
    assert json.loads(line(again[0]))["time"] == found[0].time == 0.0
    assert found[1].time == pytest.approx(1 / RATE)
