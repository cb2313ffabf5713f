"""Describe a joint of your own: make a description from datasheets, check one, look at one. See docs/joints.md."""
