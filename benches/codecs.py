"""Measures size and time of small messages as JSON, CBOR, MessagePack, zstd, and zstd with a dictionary."""

import json
import os
import subprocess
import tempfile
from pathlib import Path

import telemetry
from table import Table

MESSAGES = 2000


def run() -> Table:
    recordings = telemetry.recordings(MESSAGES)
    with tempfile.TemporaryDirectory() as folder:
        arguments = []
        for kind, (train, measure) in recordings.items():
            for name, lines in (("train", train), ("measure", measure)):
                (Path(folder) / f"{kind}.{name}").write_text("\n".join(lines))
            arguments += [kind, f"{folder}/{kind}.train", f"{folder}/{kind}.measure"]
        program = os.environ["RECT_CODECS"]
        output = subprocess.run([program, *arguments], check=True, stdout=subprocess.PIPE, text=True).stdout
    table = Table(
        "Small JSON messages: size, and time to encode and decode one",
        ["kind", "format", "bytes", "of JSON", "encode", "decode"],
    )
    for line in output.splitlines():
        row = json.loads(line)
        table.add(
            row["kind"],
            row["format"],
            f"{row['bytes']:.0f}",
            f"{row['ratio']:.2f}",
            f"{row['encode_us']:.1f} us",
            f"{row['decode_us']:.1f} us",
        )
    table.notes = [
        f"Means over {MESSAGES} messages of each kind ({len(recordings['weather'][1])} of `weather`), the best of ten "
        "alternating rounds, one thread. The dictionary has at most 16 kB and was trained on other recordings: of two "
        "other robots on other days, or, of `weather`, of other years.",
        "`joint`, `motion` and `status` are generated to resemble recordings (`telemetry.py`); `weather` is "
        "seattle-weather.csv of vega_datasets. Target for the dictionary: 0.30 of JSON, 20 us to encode, 10 us to "
        "decode. The header of a frame that names its dictionary and its length takes 11 bytes.",
        "JSON, CBOR and MessagePack start from and end in a tree of values (`serde_json::Value`); zstd starts from and "
        "ends in JSON text, whose time has to be added. `;zstd` in the encoding takes 5 bytes that are not counted "
        "here. Messages that zstd does not make smaller are sent uncompressed.",
    ]
    return table
