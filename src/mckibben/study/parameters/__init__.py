"""What a study varies: numbers of a scenario by name, what they range over, tables of values, and runs in lanes."""

from mckibben.study.parameters.address import Address, addresses, find, find_all
from mckibben.study.parameters.design import Kind, Table, design
from mckibben.study.parameters.grammar import read_over, read_overs
from mckibben.study.parameters.lanes import Known, allowed, known_names, lanes, with_values
from mckibben.study.parameters.over import Over, over
from mckibben.study.parameters.rewriting import rewritten
from mckibben.study.parameters.spread import LogUniform, Normal, Spread, Uniform, Values, Wholes

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
