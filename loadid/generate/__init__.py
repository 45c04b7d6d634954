"""Training sets: loads drawn from a declared distribution, and what sensors read of them through an independent model.

A set is a folder of shards that any number of workers write; a `TrainingSet` opens it. Measured pairs of load and
response are one too (`TrainingSet.of`).
"""

from ._examples import Examples as Examples
from ._trainingset import TrainingSet as TrainingSet

__all__ = ["Examples", "TrainingSet"]
