"""One unit of work each: fetch from the lake, call a model or a driver, append to the lake."""
