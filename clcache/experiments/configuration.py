"""What is measured: a method and its settings, as the command line and `Renderer` take them."""

import shlex
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

from ..renderer import Renderer
from ..scene.model import Scene


@dataclass(frozen=True)
class Configuration:
    """A way to render. settings: dotted name -> value, beside the scene's. spp: samples for each pixel, or updates of a cache."""

    name: str
    method: str
    settings: Mapping[str, object] = field(default_factory=dict)
    spp: int = 1
    temporal: str = "none"
    stereo_blend: str = "none"
    memo: str = "off"

    def entry(self) -> dict:
        """All of it, for JSON."""
        return asdict(self)

    @classmethod
    def of(cls, entry: Mapping) -> "Configuration":
        """From what `entry` gave."""
        return cls(**entry)

    def options(self) -> str:
        """The options of `clcache render` that say the same, as a shell takes them."""
        words = ["--method", self.method, "--spp", str(self.spp), "--temporal", self.temporal]
        words += ["--stereo-blend", self.stereo_blend] if self.stereo_blend != "none" else []
        words += ["--memo", self.memo] if self.memo != "off" else []
        for name, value in self.settings.items():
            words += ["--set", f"{name}={str(value).lower() if isinstance(value, bool) else value}"]
        return shlex.join(words)

    def renderer(
        self,
        scene: Scene,
        size: tuple[int, int],
        stereo: bool,
        seed: int,
        device: str | int | None = None,
        threads: int | None = None,
        **own: object,
    ) -> Renderer:
        """A renderer of this kind. own: what else `Renderer` takes. Raises SettingError, DeviceError."""
        return Renderer(
            scene,
            self.method,
            size,
            stereo=stereo,
            seed=seed,
            spp=self.spp,
            settings=dict(self.settings),
            temporal=self.temporal,
            stereo_blend=self.stereo_blend,
            memo=self.memo,
            device=device,
            threads=threads,
            **own,
        )
