"""Scenarios of joints in series: each with its own motion, drive, sensors and filters, the load on it also from the others."""
