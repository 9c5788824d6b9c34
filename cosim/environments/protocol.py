"""The kinds of messages between an environment and the processes of its traffic; light to import.

The traffic tells of each START, then what the same groups did when they were LEFT_TO_SUMO, and at last that it is DONE.
An episode is asked to ACT or to FORK, and answers with its STATE, or with its END.
"""

START, LEFT_TO_SUMO, DONE = "start", "left_to_sumo", "done"
ACT, FORK = "act", "fork"
STATE, END = "state", "end"
WRONG_INPUT, FAILED = "wrong_input", "failed"
