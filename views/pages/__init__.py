"""Pages: HTML in one file each, made of templates; the code computes what stands in them, the templates say it."""

from .diagnosis import html, write_report

__all__ = ["html", "write_report"]
