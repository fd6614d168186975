"""The `fast` command line. Commands import their bodies only when they are called."""
