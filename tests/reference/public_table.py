"""Every module of the wheel and the public table of each package, for the contract tests to walk through."""

import importlib
import inspect
import pkgutil
from dataclasses import is_dataclass

PACKAGES = ("okid", "era", "modal")
TABLES = (*PACKAGES, "modal.discrepancy")


def module_names():
    names = []
    for package in PACKAGES:
        names.append(package)
        names += [
            module.name
            for module in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}.")
            if not module.name.endswith("__main__")
        ]
    return names


def public_table():
    """{"okid.Record": object} of everything in the `__all__` of the three packages and of `modal.discrepancy`."""
    table = {}
    for package in TABLES:
        root = importlib.import_module(package)
        table |= {f"{package}.{name}": getattr(root, name) for name in getattr(root, "__all__", ())}
    return table


def public_functions():
    return {name: thing for name, thing in public_table().items() if inspect.isfunction(thing)}


def public_types():
    return {name: thing for name, thing in public_table().items() if inspect.isclass(thing)}


def dataclasses_everywhere():
    """Every public dataclass of every module, where it is defined."""
    found = {}
    for name in module_names():
        module = importlib.import_module(name)
        for own, thing in vars(module).items():
            public = not own.startswith("_")
            if public and inspect.isclass(thing) and is_dataclass(thing) and thing.__module__ == name:
                found[f"{name}.{own}"] = thing
    return found
