"""Loads that only push, over records of any length: non-negative Tikhonov with a duality gap, O(N) for each step.

    problem = NonNegativeRecord(path.record, signed)              # solver.py; path: a StateSpacePath
    found = problem.solve(lam * float(path.scale))                # at the lambda that the path chose
    chosen = discrepancy(problem, found.lam, sigma, warm=found)   # discrepancy.py; where the noise level is known

On the half-sine benchmark the lambda of the unconstrained discrepancy serves wide pulses; with the noise level known,
the second step is never worse and lowers the error of narrow ones by up to two fifths. Its price: some more solutions.

What may be said of the spread: the posterior std of the path without signs is an upper bound for loads that push, held
or free (`NonNegativeRecord.spread` says why); the std of the face alone tells what noise does while the active set
stays, is 0 where a load is held, and is no confidence.
"""
