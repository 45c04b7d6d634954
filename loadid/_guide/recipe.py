"""The ten steps, in order: what each is for, what it is signed with, and on what a signature stands."""

from __future__ import annotations

from dataclasses import dataclass

from structures._advice import did_you_mean
from structures.errors import InputError

VERIFY, CANDIDATES, FREEZE, INVERSE, VALIDATE = 2, 3, 7, 8, 9


@dataclass(frozen=True)
class RecipeStep:
    """One step.

    Parameters
    ----------
    number : int
    name, why : str
        What is done; what it guards against.
    needs : str
        What must be there before it is signed.
    evidence : str
        Files that are named on the command line, as its help shows them; "" where none are needed.
    stands_on : tuple of str
        What beside the evidence makes a signature stale when it changes: ``"model"``, ``"log"``, ``"settings"``.
    """

    number: int
    name: str
    why: str
    needs: str
    evidence: str
    stands_on: tuple[str, ...]

    @property
    def title(self) -> str:
        """``"2 verify the forward model"``."""
        return f"{self.number} {self.name}"


ALL = ("model", "log", "settings")
STEPS = tuple(
    RecipeStep(number, *row)
    for number, row in enumerate(
        (
            ("characterise the material or structure",
             "every number of the model comes from somewhere: stiffness, mass, damping, supports, a calibration",
             "what the model was made from: test reports, data sheets, a model from a modal test to compare with",
             "FILE...", ("model",)),
            ("verify the forward model",
             "an inverse on a wrong model converges to the answer of the wrong question, and no residual tells",
             "a record of a known load that was not used to make the model, or a model file that holds its certificate",
             "RECORD", ("model",)),
            ("candidate loads and sensors",
             "loads that no sensor sees, and loads that the sensors cannot tell apart, cannot be found",
             "the model with the loads that may act and the sensors that are read", "", ("model", "settings")),
            ("SVD, Picard and recoverable modes",
             "the data decide how many components of the load can be found, before any resolution is promised",
             "a representative record, the log of the job", "", ALL),
            ("physical constraints",
             "what is known of every load, such as that it only pushes, does work that no lambda can do",
             "nonnegative, bounds, acting or resultant in the job, or none of them", "", ALL),
            ("penalty",
             "what the data leave open is filled by the prior: it must be chosen, and said",
             "penalty in the job; identity where none is named", "", ALL),
            ("lambda, then frozen",
             "a lambda that follows every record makes records incomparable; rules that disagree are a diagnosis",
             "a noise level: noise in the job or the model, a quiet part of the log, or a record without load",
             "[QUIET]", ALL),
            ("the precomputed inverse",
             "with lambda frozen, a reading costs one product, and every reading is treated alike",
             "the lambda of step 7", "", ALL),
            ("validation at two levels",
             "a right resultant proves little of a distribution: both are held against what is known",
             "records of known loads, with channels named as the loads or as their resultants", "RECORD...", ALL),
            ("drift monitor",
             "materials age, gauges creep and supports settle: the certificate of step 2 is asked again",
             "a later record; with its known load the gains are checked again", "RECORD", ALL),
        ),
        start=1,
    )
)  # fmt: skip


def step(number: int) -> RecipeStep:
    """A step by its number."""
    return STEPS[number - 1]


def number_of(text: str) -> int:
    """Number of a step that a user names, by number or by name.

    Raises
    ------
    InputError
        None is called that.
    """
    word = text.strip().lower()
    for one in STEPS:
        if word in (str(one.number), one.name.lower()):
            return one.number
    raise InputError(
        "there is no such step",
        where="loadid guide sign",
        found=repr(text)[:80],
        expected="a number from 1 to 10",
        hint="loadid guide status lists them" + did_you_mean(word, [one.name for one in STEPS]),
    )
