"""A campaign in its lake: its config, what it starts from, where it stands, and what people ask of it.

`config` and `settings` are its TOML file, `setup` what it starts from, `state` where it stands (derived from the lake
by SQL), `requests` what people ask of it, `simulator_versions` which simulator a stage uses, `prefect_tasks` the
boundaries that show in Prefect's pages.
"""
