"""What the location of a sensor says of it."""

import numpy as np
import pandas as pd
import pytest

from errpipe.domain.recording import Manifest, Recording
from errpipe.terms._drivers import ROOM_WORDS, mentions


@pytest.mark.parametrize(
    ("location", "room"),
    [
        ("machine room", True),
        ("workshop", True),
        ("Halle 3", True),
        ("shop_floor", True),
        ("hall sensor of the motor", False),
        ("shallow bore of the column", False),
        ("headroom above the ram", False),
        ("spindle", False),
    ],
)
def test_a_word_within_another_is_no_room(location, room):
    columns = {"T": {"role": "temperature", "unit": "degC", "location": location}}
    manifest = Manifest.model_validate({"recording": 1, "tables": ["r.csv"], "columns": columns})
    assert mentions(Recording(manifest, pd.DataFrame({"T": np.arange(3.0)})), "T", ROOM_WORDS) == room
