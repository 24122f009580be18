"""Loaders, one module per dataset: files of scans, times and poses."""
