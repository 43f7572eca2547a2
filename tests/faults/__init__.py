"""The study of faults: commands that are killed, starved, disturbed and taken up again (`make faults`).

`inputs.py` makes the small logs and tables that `commands.py` needs, `process.py` begins commands as processes and ends
them, `cases.py` and `scarce.py` have a function for each fault, and `study.py` does cases one after the other, each once, and
counts their outcomes.
"""
