"""The Prefect server and worker of a lake.

`server` finds or starts a server, `database` gives it an empty database, `lab` keeps a server and a worker for `fast
serve`, `crashed_runs` ends flow runs whose process is gone and continues their campaigns. Server and worker are child
processes that are started again when they die.
"""
