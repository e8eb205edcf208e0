"""Campaigns: tables of trainings and evaluations, run from one file.

The queue is `graphlib` and `subprocess` from the standard library. Build tools were weighed and left out: doit keeps
what is done in a database of its own and knows of no half-finished target; snakemake removes the outputs of a job that
failed, from which a training would go on, and brings many packages; luigi wants a scheduler to run. None can show how
far a training is. What is left without them is the order of the jobs and one loop (`run`).
"""
