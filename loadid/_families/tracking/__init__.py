"""Load tracking: priors by name, tuning, the engine that answers every sample, the certificate."""
