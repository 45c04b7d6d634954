"""Campaigns: random problems that a user would have, with truths made by another route than the inverse.

``python -m tests.campaigns static --problems 200 --seed 1`` prints the table of one; its docstring says what is drawn.
"""
