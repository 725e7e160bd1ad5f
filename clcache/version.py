"""The version, once: the package, the files that it writes and the distribution all read it here."""

__version__ = "0.1.0"
