"""Lumped masses in series: spring-mass chains, shear buildings, the single oscillator."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from .._channels import Dof, direction_code, direction_label
from .._system.damping import Damping, settled
from .._system.fields import Lumped
from .._system.structure import Structure
from ..errors import InputError, numbers, one_of, shown

ENDS = ("fixed", "free")


def chain(
    *,
    masses: ArrayLike,
    springs: ArrayLike,
    dashpots: ArrayLike | None = None,
    left: str = "fixed",
    right: str = "free",
    direction: str = "X",
    damping: Damping | float | None = None,
) -> Structure:
    """Masses in a row, joined by springs.

    The masses are nodes 1 to n. A fixed end is a supported node: 0 on the left, n + 1 on the right, so that its
    reaction can be asked for.

    Parameters
    ----------
    masses : sequence, length n
        kg, positive.
    springs : float or sequence
        N/m, positive, from left to right: one between two masses, and one to each fixed end. One number serves all.
    dashpots : float or sequence, optional
        N s/m beside each spring, not negative.
    left, right : {"fixed", "free"}
        Ends.
    direction : str
        Direction of the motion.
    damping : Rayleigh, Modal, Structural or float, optional
        Damping of the whole; a number is the ratio of every mode.

    Raises
    ------
    InputError
        If a value is not positive, a count is wrong or an end is unknown.
    """
    for side, end in (("left", left), ("right", right)):
        one_of("unknown end", end, ENDS, where=f"chain, {side}", hint=f'{side}="fixed"')
    m = _values("masses", masses, None)
    first, last = (0 if left == "fixed" else 1), (m.size + 1 if right == "fixed" else m.size)
    nodes = range(first, last + 1)
    k = _values("springs", springs, len(nodes) - 1)
    axis = direction_code(direction)
    dofs = tuple(Dof(node, axis) for node in nodes)
    mass = np.zeros(len(nodes))
    mass[1 - first : 1 - first + m.size] = m
    return Structure(
        K=_series(k),
        M=sparse.diags_array(mass),
        C=None if dashpots is None else _series(_values("dashpots", dashpots, len(nodes) - 1, zero=True)),
        dofs=dofs,
        supports=tuple(dof for dof in dofs if dof.node in (0, m.size + 1)),
        damping=settled(damping),
        field=Lumped(direction_label(abs(axis))[1:], len(nodes)),
    )


def shear_building(
    *,
    masses: ArrayLike,
    stiffnesses: ArrayLike,
    dashpots: ArrayLike | None = None,
    damping: Damping | float | None = None,
) -> Structure:
    """Storeys with rigid floors that sway along X; floor k is node k, the ground is node 0 and supported.

    Parameters
    ----------
    masses : sequence, length n
        Mass of each floor (kg).
    stiffnesses : float or sequence, length n
        Lateral stiffness of each storey (N/m), the lowest first.
    dashpots : float or sequence, length n, optional
        N s/m between floors.
    damping : Rayleigh, Modal, Structural or float, optional
        Damping of the whole; a number is the ratio of every mode.

    Raises
    ------
    InputError
        If a value is not positive or a count is wrong.
    """
    return chain(masses=masses, springs=stiffnesses, dashpots=dashpots, damping=damping)


def oscillator(
    *, mass: float, stiffness: float, dashpot: float | None = None, damping: Damping | float | None = None
) -> Structure:
    """One mass on one spring; the mass is ``1+X``, the ground ``0+X``.

    Parameters
    ----------
    mass, stiffness : float
        kg and N/m, positive.
    dashpot : float, optional
        N s/m.
    damping : Rayleigh, Modal, Structural or float, optional
        Instead of a dashpot; a number is the ratio.

    Raises
    ------
    InputError
        If a value is not positive.
    """
    return chain(masses=[mass], springs=stiffness, dashpots=dashpot, damping=damping)


def _values(name: str, values: ArrayLike, count: int | None, zero: bool = False) -> NDArray[np.float64]:
    """Finite positive values; a scalar is repeated `count` times."""
    x = numbers(values)
    if isinstance(values, str) or x.ndim == 2 or (x.size == 0 and np.iterable(values) and len(list(values)) > 0):
        raise InputError(
            f"{name} are no numbers",
            where="chain",
            found=shown(values),
            expected="a sequence of numbers, from left to right",
            hint=f"{name}=[1.0, 2.0], for example",
        )
    x = np.full(count, float(x)) if x.ndim == 0 and count is not None else np.atleast_1d(x)
    if x.ndim != 1 or (count is not None and x.size != count) or x.size + (count is not None) == 0:
        expected: Sequence[str] | str = (
            "a sequence, at least one" if count is None else f"{count} values, from left to right"
        )
        raise InputError(
            f"wrong number of {name}",
            where="chain",
            found=f"shape {x.shape}",
            expected=expected,
            hint="a fixed end has a spring of its own, a free one has none",
        )
    bad = ~(np.isfinite(x) & ((x >= 0) if zero else (x > 0)))
    if bad.any():
        i = int(np.argmax(bad))
        raise InputError(
            f"{name} must {'not be negative' if zero else 'be positive'}",
            where=f"chain, {name}[{i}]",
            found=x[i],
            expected=">= 0" if zero else "> 0",
            hint=f"every one of {name} is a finite number in SI units",
        )
    return x


def _series(k: NDArray[np.float64]) -> sparse.csr_array:
    """Tridiagonal matrix of two-node links in series, links from left to right."""
    n = k.size + 1
    ends = sparse.csr_array(
        (
            np.tile([1.0, -1.0], n - 1),
            (np.repeat(np.arange(n - 1), 2), np.stack([np.arange(n - 1), np.arange(1, n)], 1).ravel()),
        ),
        shape=(n - 1, n),
    )
    return (ends.T @ sparse.diags_array(k) @ ends).tocsr() if n > 1 else sparse.csr_array((n, n))
