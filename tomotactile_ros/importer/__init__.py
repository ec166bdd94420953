"""Readings in files of other programs (CSV, TSV, MATLAB, numpy, arrays in bags), made into frames."""
