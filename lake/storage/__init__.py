"""Where a lake's files are: a folder, or an object store with a folder as its copy."""
