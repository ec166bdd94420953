"""Pressure images for people: coloured pixels, a terminal, a PNG file, contacts as lines."""
