"""The comparison of strategies: runs on landscapes that answer at once, or whole campaigns on a virtual bench.

`strategies` are the rows of the paper's table. `landscape` is a made-up world, `landscape_run` one strategy on it,
`landscape_study` many in worker processes, `landscape_table` what they say. `campaign_runs` and `campaign_table` are
the same for campaigns.
"""
