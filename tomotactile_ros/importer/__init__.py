"""Readings in files of other programs (CSV, TSV, MATLAB, numpy), made into frames."""
