"""Scenarios of joints in series, each with its own motion, drive, sensors and filters, and loaded by the others."""
