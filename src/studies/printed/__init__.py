"""Printed numbers of any paper, their comparison with ours, and the verdict on them.

numbers      the printed numbers and statements
comparison   one number beside the redraws of its experiment
relation     a relation that printed numbers must fulfil
judgement    a verdict with its reason, and the ways to reach one
shown        where something that a paper shows is found here
"""
