"""One module a dataset: where its scans, times and poses lie."""
