"""Notes on what a component or an output is: N606 completed, not tracked; N610 a resultant, not a map."""

from __future__ import annotations

from collections.abc import Mapping

from structures.flags import Evidence, Flag

PROVIDED = ("tracked", "measured", "completed")


def completed(provided: Mapping[str, str], source: str = "") -> Flag | None:
    """N606: a component of the motion was completed from an assumption.

    Parameters
    ----------
    provided : mapping of component to label
        ``{"x": "tracked", "y": "tracked", "z": "completed"}``.
    source : str
        What completed it: an indenter, a condition on the traction.
    """
    assumed = [name for name, label in provided.items() if label == "completed"]
    if not assumed:
        return None
    words = ", ".join(f"{name} {label}" for name, label in provided.items())
    return Flag(
        "N606",
        Evidence("components completed", ", ".join(assumed), "none"),
        f"{words}" + (f" from {source}" if source else ""),
        "do not validate with what supplied it; measure the normal motion where it decides",
    )


def resultant_output(method: str, numbers: int = 6) -> Flag:
    """N610: a method that gives resultants, and no map.

    Parameters
    ----------
    method : str
    numbers : int
        Resultants that it gives.
    """
    return Flag(
        "N610",
        Evidence("numbers in the output", numbers, "a map"),
        f"{method} gives {numbers} resultants: there is no map to plot",
        "compare it at level resultant only",
    )
