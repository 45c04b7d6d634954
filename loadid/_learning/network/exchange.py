"""A network as an ONNX model, and a model run by onnxruntime."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

from .graph import Graph, Step

Array = NDArray[Any]
OPSET = 17


def library(name: str) -> Any:
    """A module of the extra ``learn``.

    Raises
    ------
    InputError
        It is not installed.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        raise InputError("this needs a library that is not installed", where="network", found=f"no module {name}",
                         expected="the extra 'learn'", hint="pip install 'loadid[learn]'") from None  # fmt: skip


def to_onnx(graph: Graph, axes: int) -> bytes:
    """The network as an ONNX model, weights within; values have `axes` axes after the channels, of any length.

    Raises
    ------
    InputError
        onnx is not installed.
    """
    onnx = library("onnx")
    helper, number = onnx.helper, onnx.TensorProto.FLOAT
    nodes = [node for step in graph.steps for node in _nodes(helper, step)]
    kept = [onnx.numpy_helper.from_array(np.asarray(v, np.float32), k) for k, v in sorted(graph.weights.items())]
    if any(step.kind == "double" for step in graph.steps):
        kept.append(onnx.numpy_helper.from_array(np.array([1, 1, 2, 2], np.float32), "doubled"))
    first, last = graph.steps[0], graph.steps[-1]
    named = [f"side{k}" for k in range(axes)]
    ends = [
        helper.make_tensor_value_info(name, number, ["n", channels, *named])
        for name, channels in (("in", first.shape[1]), ("out", last.shape[0]))
    ]
    made = helper.make_graph(nodes, "map", ends[:1], ends[1:], kept)
    model = helper.make_model(made, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=9)
    onnx.checker.check_model(model)
    return bytes(model.SerializeToString())


class Runner:
    """What an ONNX model makes of values, by onnxruntime on one thread.

    Raises
    ------
    InputError
        onnxruntime is not installed.
    """

    def __init__(self, model: bytes) -> None:
        ort = library("onnxruntime")
        settings = ort.SessionOptions()
        settings.intra_op_num_threads = settings.inter_op_num_threads = 1
        self._model = model
        self._session = ort.InferenceSession(model, settings, providers=["CPUExecutionProvider"])

    def __reduce__(self) -> tuple[Any, ...]:
        return Runner, (self._model,)

    def __call__(self, values: Array) -> Array:
        """What comes out of what goes in."""
        return np.asarray(self._session.run(["out"], {"in": np.asarray(values, np.float32)})[0])


def _nodes(helper: Any, step: Step) -> list[Any]:
    takes, own = list(step.takes), list(step.weights)
    match step.kind:
        case "dense":
            return [helper.make_node("Gemm", [*takes, *own], [step.makes], transB=1)]
        case "convolve":
            taps = step.shape[2:]
            room = [step.wide * (n // 2) for n in taps]
            return [helper.make_node("Conv", [*takes, *own], [step.makes], kernel_shape=list(taps), pads=room + room,
                                     dilations=[step.wide] * len(taps))]  # fmt: skip
        case "pool":
            return [helper.make_node("AveragePool", takes, [step.makes], kernel_shape=[2, 2], strides=[2, 2])]
        case "double":
            return [helper.make_node("Resize", [*takes, "", "doubled"], [step.makes], mode="nearest",
                                     coordinate_transformation_mode="asymmetric", nearest_mode="floor")]  # fmt: skip
    kind = {"rectify": "Relu", "add": "Sum", "join": "Concat"}[step.kind]
    return [helper.make_node(kind, takes, [step.makes], **({"axis": 1} if kind == "Concat" else {}))]
