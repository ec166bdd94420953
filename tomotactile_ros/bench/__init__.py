"""The measured trade of speed for accuracy, on the user's own machine; behind `tomotactile
bench`."""
