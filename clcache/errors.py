"""The errors that clcache raises on purpose; each message is one line, and is what the command line prints."""


class Error(Exception):
    """Base of all errors that clcache raises on purpose."""


class SceneError(Error):
    """A scene file, or a file that it names, cannot be used; the message names the file and the place in it."""


class SettingError(Error):
    """A setting, an option or a name is unknown or out of its range."""


class DeviceError(Error):
    """No OpenCL device works, or the chosen one cannot do what is asked (memory, build, launch)."""
