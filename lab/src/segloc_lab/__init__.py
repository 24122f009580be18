"""The laboratory of segloc: simulation, training, studies, protocols, benchmarks, calibration."""
