"""The ten steps of one job as a document that lives: what each needs, what it says, who signed, what has changed since.

`recipe.py` names the steps, `ledger.py` keeps the signatures, `standing.py` says which of them still hold, the figures
of each step come from `figures.py` and its neighbours, `job.py` holds them together and `page.py` writes them down.
"""
