"""Networks that correct the linear map: as data, trained by torch, carried out by numpy or onnxruntime."""

from .engine import NetworkEngine
from .training import Schedule

__all__ = ["NetworkEngine", "Schedule"]
