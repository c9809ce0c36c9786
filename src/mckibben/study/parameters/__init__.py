"""What a study varies: numbers of a scenario by name, what they range over, tables of values, and runs in lanes."""

from mckibben.study.parameters.addresses import Address, addresses, find, find_all
from mckibben.study.parameters.distributions import LogUniform, Normal, Spread, Uniform, Values, Wholes
from mckibben.study.parameters.rewriting import rewritten
from mckibben.study.parameters.sampling import Kind, Over, Table, design, over, read_over, read_overs
from mckibben.study.parameters.values import Known, allowed, known_names, lanes, with_values

__all__ = [
    "Address",
    "Kind",
    "Known",
    "LogUniform",
    "Normal",
    "Over",
    "Spread",
    "Table",
    "Uniform",
    "Values",
    "Wholes",
    "addresses",
    "allowed",
    "design",
    "find",
    "find_all",
    "known_names",
    "lanes",
    "over",
    "read_over",
    "read_overs",
    "rewritten",
    "with_values",
]
