"""From evidence to a name.

`name`: whether there is an alarm, and everything that a round reports. `decide`: the answer, with the odds that the
rehearsal gives it.
"""
