"""Forward models: reduction, discretisation, state space, arrays, measured and tabulated FRFs."""
