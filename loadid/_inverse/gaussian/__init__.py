"""Linear-Gaussian systems: exact Tikhonov over whole records in O(N), filters and smoothers of loads with priors.

One system, ``x_{k+1} = F x_k + G w_k, y_k = C x_k + D w_k + v_k`` with Gaussian w and v, asked from its two ends:

=================  =========================================  ======================================================
                   deconvolution of a record                  filter and smoother of a stream
=================  =========================================  ======================================================
model              `record.WhitenedRecord`: w of std 1/lam,   `model.FilterModel`: roots LQ, LR and S of the
                   v of std 1, states that start free         covariances, start x0, L0
recursion          `gains`: information of later samples,     `model.SquareRoot`: covariance, forward;
                   backward; one QR a sample, compiled        one QR a sample, LAPACK, for any channels missing
settled            `compiled.settled`: by its own change      `steady`: the fixed point by doubling, then QR; a sample
                   and decay, exact for a finite record       is at it by the relative distance of its variances
mean               `passes`: backward drive, forward loads    `loop` forward; `records` backward (Bryson & Frazier)
blocks             `passes.run_blocks`, wherever the gain has settled, of either
spread             `posterior.variances`: covariance forward  `records`: P - P Lambda P, a root backward
callers            `path`, `sized`, `coarse`                  `loadid._families.tracking`
=================  =========================================  ======================================================

The recursions are one by duality: ``root <- triangle of [noise | ahead root]`` with ``ahead = [G^T; F^T]`` and
``noise = [D^T, lam I; C^T, 0]`` there, ``[H F; F]`` and ``[H LQ, LR; LQ, 0]`` here (a test holds them to rounding).
They keep their two forms because each fails where the other stands. A free start has no covariance, and the filter of
its wide stand-in keeps seven digits; at a small lambda D w hides the noise: on a building with 200 samples a relative
lambda of 1e-6, 1e-8 costs the covariance form 6e-11, 1e-9 of the load, the information form 6e-15 throughout. And they
keep their two codes: with 20 states in modal form the compiled step takes 10 us where LAPACK takes 50, for hundreds of
lambdas; with 40 coupled ones it takes 92 against 77, and a stream that starts anew would wait for the compiler.
"""
