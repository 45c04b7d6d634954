"""The structure and what touches it: K, M, C, DOFs, damping, factorisation, condensation, sensors, loads."""
