"""From test records to FRFs: spectra, hits, estimators, the kinds of FRF, causality."""
