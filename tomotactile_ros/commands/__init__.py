"""The commands of `tomotactile`, one module each: HELP, add_arguments(parser), run(args)."""
