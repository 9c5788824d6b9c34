"""The paper's tables and figures: rows as data, trained as jobs, written beside the printed figures.

Begin with `reproduce`, which decides what is to be trained; `rows` says what the tables consist of.
"""
