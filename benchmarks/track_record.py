"""Store the track record that reports quote: forearm_fem/track_record.json, from a folder of ``validate``.

forearm-fem validate thesis --set engine=layered --draws 140 --hold tape --out results/validation
python3 benchmarks/track_record.py results/validation/prediction

Tape is held, as builders have none on the skin: the width of the bands stands for their arms.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from forearm_fem.show.answer import FILE, TrackRecord

if __name__ == "__main__":
    found = json.loads((Path(sys.argv[1]) / "validation.json").read_text(encoding="utf-8"))
    record = TrackRecord.of(found)
    (Path(__file__).resolve().parents[1] / "forearm_fem" / FILE).write_text(record.as_text(), encoding="utf-8")
    print(record.sentence)
