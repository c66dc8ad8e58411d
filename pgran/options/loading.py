"""Loading of the classes that an option names: flow problems, mu(I) laws and models."""

import functools
import importlib
import os
import pkgutil
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from .definition import Option
from .errors import ParameterError


def modules_of(path):
    """Return the names of the public modules in the ``__path__`` of a package, a tuple."""
    return tuple(sorted(module.name for module in pkgutil.iter_modules(path)
                        if not module.name.startswith("_")))


def allowed_names(names):
    """Return the allowed values of an option that names one of these modules or a class."""
    return " | ".join((*names, "package.module:Class", "path/to/file.py:Class"))


@dataclass(frozen=True)
class Component:
    """A component of a simulation: the case, the law or the model, a subclass of ``base``.

    An option names a module of ``package`` or a class (`allowed_names`).
    """

    name: str
    package: str
    base: type

    @property
    def names(self):
        """The names of the modules of the package."""
        return modules_of(importlib.import_module(self.package).__path__)

    def load(self, text):
        """Return the class that ``text`` names, or raise `ParameterError`."""
        def refuse(reason):
            raise ParameterError(self.name, text, reason)

        target, _, name = text.rpartition(":")
        if not target and text not in self.names:
            refuse(f"expected one of: {allowed_names(self.names)}")
        modified = os.stat(target).st_mtime_ns if os.path.isfile(target) else None
        try:
            module = _module(target or f"{self.package}.{text}", modified)
        except (Exception, SystemExit) as error:  # a user-defined file may fail in any way
            refuse(f"{target} cannot be imported: {type(error).__name__}: "
                   f"{str(error).splitlines()[0] if str(error) else 'no reason given'}")
        classes = {key: value for key, value in vars(module).items()
                   if isinstance(value, type) and issubclass(value, self.base)
                   and value.__module__ == module.__name__}
        found = getattr(module, name, None) if target else next(iter(classes.values()))
        if found is None:
            refuse(f"{target} has no class {name}; it has {', '.join(classes) or 'no such class'}")
        if not (isinstance(found, type) and issubclass(found, self.base)):
            refuse(f"{name} is not a subclass of {self.base.__module__}.{self.base.__name__}")
        if missing := sorted(found.__abstractmethods__):
            refuse(f"{name} lacks {', '.join(missing)}")
        if hasattr(found, "rows"):
            refuse(f"rows of {name} is now options")
        if not all(isinstance(option, Option) for option in found.options):
            refuse(f"options of {name} must be a tuple of pgran.options.Option")
        return found


@functools.cache
def _module(target, modified):
    """Import a dotted name, or the version of a file with this time of modification."""
    if not target.endswith(".py"):
        return importlib.import_module(target)
    path = Path(target)
    if not path.is_file():
        raise FileNotFoundError("there is no such file")
    module = ModuleType(f"pgran_user_{path.stem}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module  # dataclasses in the file look it up
    # Without bytecode, which might be of an earlier version.
    exec(compile(path.read_bytes(), path, "exec"), vars(module))
    return module
