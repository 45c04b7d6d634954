"""Training sets: loads drawn from a declared distribution, and what sensors read of them through an independent model.

A set is a folder of shards that any number of workers write; a `TrainingSet` opens it. Measured pairs of load and
response are one too (`TrainingSet.of`). What draws is a `DrawMaker`: an object of one's own is as good as ours.
"""

from ._examples import Examples as Examples
from ._histories import HistoryDeclaration as HistoryDeclaration
from ._histories import ModelRange as ModelRange
from ._histories import ReadingRange as ReadingRange
from ._histories import histories as histories
from ._loads import LoadRange as LoadRange
from ._overview import overview as overview
from ._plan import generate_from as generate_from
from ._trainingset import TrainingSet as TrainingSet
from ._work import DrawMaker as DrawMaker
from ._work import Drawn as Drawn
from ._work import generate as generate

__all__ = [
    "DrawMaker", "Drawn", "Examples", "HistoryDeclaration", "LoadRange", "ModelRange", "ReadingRange", "TrainingSet",
    "generate", "generate_from", "histories", "overview",
]  # fmt: skip
