"""One campaign from its config to its report.

`launch` checks everything and finds a server, `process` opens workers and bench, `flow` goes through the stages with
the two loops of `loops` (bench, simulations). People are asked by `operator_prompts` and answer on the command line or
in a form (`forms`, `print_form`); `progress`, `page`, `forecast` and `status` say how far it is. All state is in the
lake.
"""
