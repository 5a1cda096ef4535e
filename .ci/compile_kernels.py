"""Compile the kernels that the package launches on a CPU, into Warp's kernel cache."""

import importlib
import pkgutil
from collections.abc import Iterator
from types import ModuleType

import torch
import warp

import samira_subject
import samira_warp
from samira_warp.kernels.runtime.loading import load


def modules() -> Iterator[ModuleType]:
    """All of them but the verbs' own programs."""
    for package in (samira_warp, samira_subject):
        for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if not found.name.endswith("__main__"):
                yield importlib.import_module(found.name)


def has_kernels(module: ModuleType) -> bool:
    """Whether it has any of its own that a CPU launches."""
    kernels = [value for value in vars(module).values() if isinstance(value, warp.Kernel)]
    return not module.__name__.endswith("_cuda") and any(
        kernel.module.name == module.__name__ for kernel in kernels
    )


# all are imported before the first is compiled: one module's source has functions of others
for module in list(modules()):
    if has_kernels(module):
        load(warp.get_module(module.__name__), torch.device("cpu"))
