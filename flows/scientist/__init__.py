"""The comparison of strategies as whole campaigns on a virtual bench.

`strategies` are the rows of the paper's table, `campaign_runs` run them, and `campaign_table` is what they say.
"""
