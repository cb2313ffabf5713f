"""Pages: HTML in one file each. The code computes the numbers, the templates have the words."""
