"""For methods of one's own: linear problems, their regularisation paths, and what a rule for lambda gets and gives.

A rule is a function ``Sweep -> RuleResult`` (`loadid.register_rule`, or ``choice=<function>``); a solver derives from
`RegularizationPath`; ``choose(SVDPath(LinearProblem.whitened(H, y, noise)))`` asks every rule of a matrix and data.
"""

from ._inverse.choice import Choice as Choice
from ._inverse.choice import choose
from ._inverse.compare import compare
from ._inverse.convolution import toeplitz
from ._inverse.path import PathPoint, RegularizationPath, Solution
from ._inverse.problem import LinearProblem
from ._inverse.svd import SVDPath
from ._inverse.sweep import Refusal, RuleResult, Sweep, crossing, minimum, need

__all__ = [
    "LinearProblem",
    "PathPoint",
    "Refusal",
    "RegularizationPath",
    "RuleResult",
    "SVDPath",
    "Solution",
    "Sweep",
    "choose",
    "compare",
    "crossing",
    "minimum",
    "need",
    "toeplitz",
]
