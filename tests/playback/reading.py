"""Recordings read back."""

import numpy as np
from rerun.chunk import RrdReader


class Reading:
    """What a file holds, by entity path: changing rows in the order of time, and static values."""

    def __init__(self, path):
        self.static, chunks = {}, {}
        for chunk in RrdReader(path).stream():
            batch = chunk.to_record_batch()
            columns = {
                name: batch.column(name) for name in batch.schema.names if not name.startswith("rerun")
            }
            if chunk.is_static:
                values = {name: column.to_pylist()[0] for name, column in columns.items()}
                self.static.setdefault(chunk.entity_path, {}).update(values)
            else:
                assert set(chunk.timeline_names) == {"step", "sim_time"}
                chunks.setdefault(chunk.entity_path, []).append(columns)
        self.rows = {path: self._joined(parts) for path, parts in chunks.items()}

    def _joined(self, parts):
        joined = {"step": np.concatenate([part["step"].to_numpy() for part in parts])}
        nanoseconds = [part["sim_time"].to_numpy(zero_copy_only=False).astype(np.int64) for part in parts]
        joined["sim_time"] = np.concatenate(nanoseconds) / 1e9
        order = np.lexsort((joined["sim_time"], joined["step"]))
        joined = {name: values[order] for name, values in joined.items()}
        for name in parts[0]:
            if ":" in name or name not in joined:
                values = [value for part in parts for value in part[name].to_pylist()]
                joined[name] = [values[index] for index in order]
        return joined

    def shown(self, path, name, steps):
        """Return for each of `steps` the value that the viewer shows: that of the last row up to it."""
        rows = self.rows[path]
        latest = np.searchsorted(rows["step"], steps, side="right") - 1
        assert latest.min() >= 0, "shown from the first step on"
        return [rows[name][index] for index in latest]


def plain(rows):
    """Return the rows of an entity as lists, to be compared."""
    return {name: list(values) for name, values in rows.items()}
