"""What happens, in which order, when: Prefect flows, the `fast` command line, reports, viewer."""
