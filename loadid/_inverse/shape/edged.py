"""Deflections of a plate under pressures that do not vanish at its edges, by Ritz's method with Legendre polynomials.

A smooth deflection with ``w = w_nn = 0`` on two edges that meet bears no load in their corner, and one that is nearly
so bears little near an edge. A real pressure, a uniform one first of all, does: its deflection is singular in the
corner. Deflections of the held plate under polynomials of low degree carry that part, and their load is known without
a derivative.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import Legendre
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from structures._readonly import ReadOnly

Array = NDArray[np.float64]
TERMS = 26  # Ritz functions along each side: curvatures of a uniform pressure to 1e-6
DEGREE = 6  # of the pressures, along each side
ZEROS = {"F": 0, "S": 1, "C": 2}  # of a function, at an edge


@dataclass(frozen=True, eq=False)
class RitzSide(ReadOnly):
    """Functions along one side: Legendre polynomials times what its two edges hold at zero.

    Parameters
    ----------
    length : float
    ends : str
        S, C or F of the two edges across it.
    """

    length: float
    ends: str

    def at(self, x: Array, order: int = 0) -> Array:
        """Derivatives of `order`, (points, TERMS)."""
        t = 2 * np.asarray(x, float) / self.length - 1
        values = np.column_stack([f.deriv(order)(t) for f in self._series])
        return np.asarray(values * (2 / self.length) ** order)

    @cached_property
    def _series(self) -> list[Legendre]:
        held = Legendre([1.0])
        for kind, end in zip(self.ends, (-1.0, 1.0), strict=True):
            for _ in range(ZEROS[kind]):
                held = held * Legendre.fromroots([end])
        return [held * Legendre.basis(k) for k in range(TERMS)]

    @cached_property
    def points(self) -> tuple[Array, Array]:
        """Places and weights of Gauss's rule, exact for every product of two functions."""
        t, weight = np.polynomial.legendre.leggauss(TERMS + 8)
        return (t + 1) * self.length / 2, weight * self.length / 2

    def form(self, one: int, other: int) -> Array:
        """Integrals of products of derivatives of these orders, (TERMS, TERMS)."""
        x, weight = self.points
        return np.asarray((self.at(x, one).T * weight) @ self.at(x, other))

    def moments(self) -> Array:
        """Integrals of the functions times `polynomials`, (TERMS, DEGREE + 1)."""
        x, weight = self.points
        return np.asarray((self.at(x).T * weight) @ self.polynomials(x))

    def polynomials(self, x: Array) -> Array:
        """Legendre polynomials of unit mean square, (points, DEGREE + 1)."""
        t = 2 * np.asarray(x, float) / self.length - 1
        return np.asarray(np.polynomial.legendre.legvander(t, DEGREE) * np.sqrt(2 * np.arange(DEGREE + 1) + 1))


@dataclass(frozen=True, eq=False)
class EdgedLoads(ReadOnly):
    """Polynomial pressures on a rectangle, and its deflections under them for a rigidity of one.

    The uniform pressure is one; the others fall by the square of their degree.

    Parameters
    ----------
    sides : (a, b)
    edges : str
        S, C or F for x = 0, y = 0, x = a, y = b.
    nu : float
        Poisson's ratio: of free edges.
    """

    sides: tuple[float, float]
    edges: str
    nu: float

    @property
    def count(self) -> int:
        """Pressures."""
        return (DEGREE + 1) ** 2

    def rows(self, x: Array, y: Array, dx: int = 0, dy: int = 0) -> Array:
        """Rows (points, pressures) of a derivative of the deflections."""
        along, across = self._along
        half = np.einsum("pj,ijk->pik", across.at(y, dy), self._coefficients)
        return np.asarray(np.einsum("pi,pik->pk", along.at(x, dx), half))

    def loads(self, x: Array, y: Array) -> Array:
        """Rows (points, pressures) of the pressures."""
        a, b = (side.polynomials(at) for side, at in zip(self._along, (x, y), strict=True))
        return np.asarray((a[:, :, None] * b[:, None, :]).reshape(len(a), -1))

    def sizes(self, steep: float) -> Array:
        """Of the pressures (pressures,): the uniform one is one, the others fall by this power of their degree."""
        degree = np.arange(DEGREE + 1)
        return np.asarray((1.0 / (1 + degree[:, None] + degree) ** steep).ravel())

    @cached_property
    def _along(self) -> tuple[RitzSide, RitzSide]:
        (a, b), e = self.sides, self.edges
        return RitzSide(a, e[0] + e[2]), RitzSide(b, e[1] + e[3])

    @cached_property
    def _coefficients(self) -> Array:
        """(TERMS, TERMS, pressures), x first."""
        x, y = self._along
        K = np.kron(x.form(2, 2), y.form(0, 0)) + np.kron(x.form(0, 0), y.form(2, 2))
        mixed = np.kron(x.form(2, 0), y.form(0, 2))
        K += self.nu * (mixed + mixed.T) + 2 * (1 - self.nu) * np.kron(x.form(1, 1), y.form(1, 1))
        scale = 1 / np.sqrt(np.diag(K))
        found = cho_solve(cho_factor(K * scale * scale[:, None]), scale[:, None] * np.kron(x.moments(), y.moments()))
        return np.asarray((scale[:, None] * found).reshape(TERMS, TERMS, -1))
