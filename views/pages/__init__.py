"""Pages: HTML in one file each. The code computes the numbers, the templates have the words."""

from .diagnosis import html, write_report

__all__ = ["html", "write_report"]
