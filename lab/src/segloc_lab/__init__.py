"""The experiments behind segloc: studies, benchmarks, protocols, calibration and weights."""
