"""Terms that are one parameter times a driver: most of what is thermal."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping

import numpy as np

from errpipe.domain.driver import Driver
from errpipe.domain.recording import Recording
from errpipe.drivers.evaluation import drive
from errpipe.drivers.lowered import Lowered
from errpipe.terms._base import Term
from errpipe.terms._warm import scaled


class Driven(Term):
    """deviation = parameter * driver. A subclass states its one linear parameter and the driver."""

    @abstractmethod
    def _driver(self, *nonlinear: float) -> Driver:
        """The driver at values of all non-linear parameters."""

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        return drive(self._driver(*nonlinear), recording)[:, None]

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        (gain,) = self.linear()
        return (Lowered(scaled(self._driver(*self.nonlinear_values(parameters)), parameters[gain.name])),)
