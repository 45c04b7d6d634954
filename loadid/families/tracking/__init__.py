"""The rooms of load tracking: priors by name, tuning, the engine that answers every sample, the certificate."""
