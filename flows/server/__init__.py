"""The Prefect server and worker of a lake: start them, keep them, mark runs that died."""
