"""Figures: their style, and files of them."""
