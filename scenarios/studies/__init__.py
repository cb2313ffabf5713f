"""Studies: seeds × parameters × scenarios × filters, as a dataset that grows while it is made."""
