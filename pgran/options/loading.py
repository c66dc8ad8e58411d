"""Loading of the classes that an option names: flow problems, mu(I) laws and models."""

import functools
import importlib
import importlib.machinery
import importlib.util
import os
import pkgutil
import sys
from dataclasses import dataclass
from pathlib import Path

from .definition import Option
from .errors import ParameterError


def modules_of(path):
    """Return the public modules in the ``__path__`` of a package, (n,) strings."""
    return sorted(module.name for module in pkgutil.iter_modules(path)
                  if not module.name.startswith("_"))


def allowed_names(path):
    """Return the allowed values of an option that names a module of a package or a class."""
    return " | ".join((*modules_of(path), "package.module:Class", "path/to/file.py:Class"))


@dataclass(frozen=True)
class Component:
    """A component of a simulation that one option chooses: the case, the law or the model.

    It is a subclass of ``base``. The option gives the name of a module of ``package``,
    ``package.module:Class`` or ``path/to/file.py:Class``.
    """

    name: str
    package: str
    base: type

    @property
    def names(self):
        """The modules of the package, (n,) strings."""
        return tuple(modules_of(importlib.import_module(self.package).__path__))

    def load(self, text):
        """Return the class that ``text`` names.

        Raises
        ------
        ParameterError
            If the class is not found or is incomplete.
        """
        def refuse(reason):
            raise ParameterError(self.name, text, reason)

        target, _, name = text.rpartition(":")
        if not target and text not in self.names:
            path = importlib.import_module(self.package).__path__
            refuse(f"expected one of: {allowed_names(path)}")
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
            refuse(f"{name} has the attribute rows; rows is now options")
        if not all(isinstance(option, Option) for option in found.options):
            refuse(f"options of {name} must be a tuple of pgran.options.Option")
        return found


class _SourceLoader(importlib.machinery.SourceFileLoader):
    """Compiles a user-defined file without reading or writing bytecode."""

    def get_code(self, fullname):
        """Return the compiled source."""
        return self.source_to_code(self.get_data(self.path), self.path)


@functools.cache
def _module(target, modified):
    """Import a dotted name, or the version of a file with this time of modification."""
    if not target.endswith(".py"):
        return importlib.import_module(target)
    path = Path(target)
    if not path.is_file():
        raise FileNotFoundError("there is no such file")
    name = f"pgran_user_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path, loader=_SourceLoader(name, str(path)))
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses in the file look it up
    spec.loader.exec_module(module)
    return module
