"""Protocols on real scans and in simulated worlds; each module runs as a script."""
