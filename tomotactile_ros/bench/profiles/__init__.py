"""The profiles in depth: benchmark/reconstruction_accuracy.py."""
