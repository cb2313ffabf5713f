"""Describe your joint: make a description from datasheets, check it, look at it. See docs/joints.md."""
