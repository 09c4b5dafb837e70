"""A small neural network from axis positions and temperatures to the deviations of the tool point, after Ni (1997).

Its hidden units become nodes of the table (a weighted sum, a table of tanh), so that a controller can compute them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from errpipe.models._base import Family, Fitted, Progress, held_out, no_progress

if TYPE_CHECKING:
    from errpipe.domain.recording import Recording
    from errpipe.fitting.holdout import Fold
    from errpipe.fitting.judging import HeldOut
    from errpipe.thermal.competition import Entrant
    from errpipe.thermal.linear import LinearProblem


class NeuralVolume(Family):
    """One layer of tanh units on positions and temperature rises; no units if none improves on no compensation."""

    family: Literal["neural_volume"] = Field("neural_volume", description="Model family.")
    components: tuple[str, ...] = Field(("E_X", "E_Y", "E_Z"), min_length=1, description="Responses of the recording.")
    units: int = Field(8, ge=1, le=32, description="Units of the hidden layer, shared by all components.")
    competes: ClassVar[bool] = True

    @classmethod
    def competitor(cls, shared: Mapping[str, Any]) -> NeuralVolume:
        """The network of the one component that all competitors model."""
        return cls(components=(shared["component"],))

    def entrants(self, problem: LinearProblem) -> Sequence[Entrant]:
        """A network of positions and rises for each penalty; none if the recording has no position."""

        from errpipe.domain import driver as d
        from errpipe.models._perceptron import Layer, entrant
        from errpipe.models._volume_network import PENALTIES, positions

        places = positions(problem.recording)
        if not places:
            return ()
        nodes = [*(d.Input(name=n) for n in places), *problem.drivers[: problem.plain]]
        centre = np.zeros(len(nodes))
        centre[: len(places)] = [np.nanmean(problem.recording.array(n)[problem.rows]) for n in places]
        name = self.family_name()
        layers = (Layer(nodes, centre, self.units, penalty) for penalty in PENALTIES)
        return [entrant(name, f"{name}, penalty {one.penalty:g}", problem, one) for one in layers]

    def fit(self, recording: Recording, progress: Progress = no_progress) -> Fitted:
        """Fit on every row. Raises DataError without a position, a component, or a complete row."""

        from errpipe.models import _volume_network as net

        x, y, drivers = net.data(recording, self.components)
        network, penalty = net.chosen(recording, x, y, np.ones(len(recording), dtype=bool), self.units)
        model = net.error_model(recording, self.components, network, x, y, drivers)
        choice = "nothing" if penalty is None else f"{self.units} units, penalty {penalty:g}"
        return Fitted(model, {}, dict.fromkeys(self.components, f"{choice} on held-out groups"))

    def validate_fold(self, recording: Recording, fold: Fold) -> Mapping[str, HeldOut]:
        """Train on one side of a fold (penalty included), validate on the other."""
        from errpipe.fitting import holdout
        from errpipe.fitting.validity import box, distance
        from errpipe.models import _volume_network as net

        holdout.check(fold)
        x, y, _ = net.data(recording, self.components)
        network, _ = net.chosen(recording, x, y, fold.train, self.units)
        left = y - network.values(x)
        outside = distance(box(recording, net.columns(recording), fold.train), recording)
        return {c: held_out(fold, y[:, k], left[:, k], outside) for k, c in enumerate(self.components)}
