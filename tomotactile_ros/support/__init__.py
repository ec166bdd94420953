"""What has nothing to do with sensors: mistakes in one line, files, the command line, processes."""
