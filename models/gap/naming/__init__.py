"""From fits to a name: rank effects, score them on held-out groups, decide."""
