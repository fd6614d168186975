"""What a campaign knows and does in its lake.

`config` and `settings` are its TOML file, `setup` what it starts from, `state` where it stands (derived from the lake
by SQL), `requests` what people ask of it, `simulator_versions` which simulator a stage uses, `prefect_tasks` the
boundaries that show in Prefect's pages.
"""
