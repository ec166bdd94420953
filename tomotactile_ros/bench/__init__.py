"""Speed against accuracy, measured on the user's own machine: behind `tomotactile
bench`."""
