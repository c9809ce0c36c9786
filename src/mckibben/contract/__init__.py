"""Contract of user-defined classes: what every component of a base must satisfy, checked on the class itself."""

from mckibben.contract.checks import ContractReport, Finding, check_class, check_extension

__all__ = ["ContractReport", "Finding", "check_class", "check_extension"]
