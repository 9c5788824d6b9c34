"""Mutants that change nothing that anybody could see, each with the reason.

They count neither as noticed nor as not noticed.
"""

# ruff: noqa: E501

SAME_VALUE = "where the condition is not met, the other branch gives the same value; the condition saves time"
EMPTY = "without any hit the loop has nothing to do, and the index gives an empty array"
ONLY_MORE_CANDIDATES = "a fast test lets more through, which the exact test after it sorts out; it saves time"
NOT_THAT_CLOSE = "no two instants of a simulation differ by exactly the millionth of a second that allows for rounding"
EQUAL_LENGTHS = "both sequences are made with the same length; the check is there for who changes the code"
TIMES_MINUS_1 = "to divide by 1 or −1 is to multiply by it"

EQUIVALENT: dict[str, str] = {
    "cosim.measures.surrogate_safety: pet: if (second.s - second.length > first.s + first.width).all() and (np.diff(second.s) >= 0).all():: if (second.s - second.length > first.s + first.width).all()  → never #1": SAME_VALUE,
    "cosim.measures.surrogate_safety: pet: if (second.s - second.length > first.s + first.width).all() and (np.diff(second.s) >= 0).all():: second.s - second.length > first.s + first.width, Gt → GtE #1": SAME_VALUE,
    "cosim.measures.surrogate_safety: pet: if (second.s - second.length > first.s + first.width).all() and (np.diff(second.s) >= 0).all():: np.diff(second.s) >= 0, GtE → Gt #1": SAME_VALUE,
    "cosim.measures.surrogate_safety: pet: if (second.s - second.length > first.s + first.width).all() and (np.diff(second.s) >= 0).all():: 0 → 0 + 1 #1": SAME_VALUE,
    "cosim.measures.surrogate_safety: pet: if (lag - PET_SUBSTEPS) * part >= below:: (lag - PET_SUBSTEPS) * part >= below, GtE → Gt #1": "such a value is not below the bound, and may be returned as inf",
    "cosim.measures.surrogate_safety: pet: exact = next((k for k in range(max(lag - PET_SUBSTEPS, 0), lag) if _overlap_after(late, early, k)), lag): 0 → 0 + 1 #1": "the lag 0 was tried before",
    "cosim.measures.surrogate_safety: _overlap_after: near = np.abs(late.xy[lag:] - early.xy[:count]).max(axis=1) < reach: np.abs(late.xy[lag:] - early.xy[:count]).max(axis=1) < reach, Lt → LtE #1": ONLY_MORE_CANDIDATES,
    "cosim.measures.surrogate_safety: _overlap_after: if not near.any():: if not near.any(): → never #1": SAME_VALUE,
    "cosim.measures.surrogate_safety: _corners: centre + 0.5 * (u * track.length * forward + w * track.width * left): centre + 0.5 * (u * track.length * forward + w * track.width, Add → Sub #1": "the corners come with all signs; the order goes round the box either way",
    "cosim.measures.surrogate_safety: _corners: centre + 0.5 * (u * track.length * forward + w * track.width * left): u * track.length * forward + w * track.width * left, Add → Sub #1": "the corners come with all signs; the order goes round the box either way",
    "cosim.measures.surrogate_safety: _corner_to_side: side = np.roll(box, -1, axis=1) - box: -1 → without its sign #1": "all four sides, each from its other end",
    "cosim.measures.surrogate_safety: _paths_may_cross: along = second.s.max() + second.width > (first.s - first.length).min() - first.width: second.s.max() + second.width > (first.s - first.length).min, Gt → GtE #1": ONLY_MORE_CANDIDATES,
    "cosim.measures.surrogate_safety: _paths_may_cross: side = 0.5 * (second.width + first.width) + 1.0 + _swing(second) + _swing(first): 0.5 → 0.5 + 1 #1": ONLY_MORE_CANDIDATES,
    "cosim.measures.surrogate_safety: _paths_may_cross: side = 0.5 * (second.width + first.width) + 1.0 + _swing(second) + _swing(first): 1.0 → 1.0 + 1 #1": ONLY_MORE_CANDIDATES,
    "cosim.measures.surrogate_safety: _paths_may_cross: across = second.d.min() - first.d.max() < side and first.d.min() - second.d.max() < side: second.d.min() - first.d.max() < side and first.d.min() - se, And → Or #1": ONLY_MORE_CANDIDATES,
    "cosim.measures.surrogate_safety: _paths_may_cross: across = second.d.min() - first.d.max() < side and first.d.min() - second.d.max() < side: second.d.min() - first.d.max() < side, Lt → LtE #1": ONLY_MORE_CANDIDATES,
    "cosim.measures.surrogate_safety: _paths_may_cross: across = second.d.min() - first.d.max() < side and first.d.min() - second.d.max() < side: first.d.min() - second.d.max() < side, Lt → LtE #1": ONLY_MORE_CANDIDATES,
    "cosim.measures.surrogate_safety: _paths_may_cross: return bool(along and across): along and across, And → Or #1": ONLY_MORE_CANDIDATES,
    "cosim.measures.surrogate_safety: _swing: moves = ds + dd > 0.05: ds + dd > 0.05, Gt → GtE #1": ONLY_MORE_CANDIDATES,
    "cosim.measures.surrogate_safety: _swing: return track.length * float((dd[moves] / np.hypot(ds, dd)[moves]).max(initial=0.0)): 0.0 → 0.0 + 1 #1": ONLY_MORE_CANDIDATES,
    "cosim.measures.surrogate_safety: _common_instants: if np.array_equal(one.time, other.time):: if np.array_equal(one.time, other.time): → never #1": SAME_VALUE,
    'cosim.measures.surrogate_safety: comfort: **{f"jerk_{100 * q:.0f}": float(value) for q, value in zip(JERK_QUANTILES, quantiles, strict=True)},: True → False #1': EQUAL_LENGTHS,
    "cosim.measures.collision_detection: overlapping_pairs: half_extent = 0.5 * (length * along + width * along[::-1])  # of the axis-parallel bounding box, in x and y: 0.5 → 0.5 + 1 #1": ONLY_MORE_CANDIDATES,
    "cosim.measures.collision_detection: overlapping_pairs: close = np.abs(centre[:, None] - centre[:, rows, None]) < half_extent[:, None] + half_extent[:, rows, None]: np.abs(centre[:, None] - centre[:, rows, None]) < half_exten, Lt → LtE #1": ONLY_MORE_CANDIDATES,
    "cosim.measures.collision_detection: overlapping_pairs: if not near.any():: if not near.any(): → never #1": SAME_VALUE,
    "cosim.measures.statistics: paired_difference: added = mean(np.append(difference, [1.0, -1.0]), np.append(index, [-1, -2])): 2 → 2 + 1 #1": "any label that no cluster has",
    "cosim.measures.statistics: with_correction: return [replace(test, p_corrected=float(found)) for test, found in zip(tests, p, strict=True)]: True → False #1": EQUAL_LENGTHS,
    "cosim.measures.statistics: _effective_size: quantile = (1 + LEVEL) / 2: 1 + LEVEL, Add → Sub #1": "both quantiles change their sign, and their ratio is squared",
    "cosim.world.road_frame: RoadFrame._vertices: return (line * [1, -1], normals * [1, -1]) if self.mirrored else (line, normals): line * [1, -1], Mult → Div #1": TIMES_MINUS_1,
    "cosim.world.road_frame: RoadFrame._vertices: return (line * [1, -1], normals * [1, -1]) if self.mirrored else (line, normals): normals * [1, -1], Mult → Div #1": TIMES_MINUS_1,
    "cosim.world.road_frame: RoadFrame.to_road: xy = xy * [1, -1]: xy * [1, -1], Mult → Div #1": TIMES_MINUS_1,
    "cosim.world.road_frame: RoadFrame.to_road: for _ in range(20):  # from the nearest segment to the one between whose normals the point is: 20 → 20 + 1 #1": "more segments than a point is ever away from its own",
    "cosim.world.road_frame: RoadFrame.to_road: move = np.where(share > 1, forward[segment], np.where(share < 0, -backward[segment], 0)): share > 1, Gt → GtE #1": "at a vertex, both segments give the same place",
    "cosim.world.road_frame: RoadFrame.to_road: move = np.where(share > 1, forward[segment], np.where(share < 0, -backward[segment], 0)): share < 0, Lt → LtE #1": "at a vertex, both segments give the same place",
    "cosim.world.road_frame: RoadFrame.to_road: if (following == segment).all():: if (following == segment).all(): → never #1": SAME_VALUE,
    "cosim.world.road_frame: RoadFrame.to_world: if self.is_straight and not self.mirrored:: if self.is_straight and (not self.mirrored): → never #1": SAME_VALUE,
    "cosim.world.road_frame: RoadFrame.to_world: return xy * [1, -1] if self.mirrored else xy, self.heading_at(s): xy * [1, -1], Mult → Div #1": TIMES_MINUS_1,
    "cosim.world.road_frame: RoadFrame.heading_at: if self.is_straight:: if self.is_straight: → never #1": SAME_VALUE,
    "cosim.world.road_frame: RoadFrame.line_at: kept = np.concatenate([[True], steps > 0]): True → False #1": "the line begins with a long straight piece, and goes on with slope 1",
    "cosim.world.road_frame: RoadFrame.stretch_at: if self.is_straight:: if self.is_straight: → never #1": SAME_VALUE,
    "cosim.world.contacts: contacts_of: if not len(hits):: if not len(hits): → never #1": EMPTY,
    "cosim.world.contacts: contacts_of: if vehicles & members[g] and vehicles not in found[g] and now.time <= end + AFTERMATH + 1e-6:: now.time <= end + AFTERMATH + 1e-06, LtE → Lt #1": NOT_THAT_CLOSE,
    "cosim.world.contacts: touching_pairs: if not len(hits):: if not len(hits): → never #1": SAME_VALUE,
    "cosim.world.contacts: touching_pairs: return hits if near.all() else hits[near]: hits if near.all() else hits[near] → never #1": SAME_VALUE,
    "cosim.world.contacts: _contact: after_hand_back=now.time > end + 1e-6,: now.time > end + 1e-06, Gt → GtE #1": NOT_THAT_CLOSE,
    "cosim.world.break_ups: lane_entries: for g, place in zip(groups, places, strict=True):: True → False #1": EQUAL_LENGTHS,
    "cosim.world.break_ups: _earlier_d: if before.ids == now.ids:: if before.ids == now.ids: → never #1": SAME_VALUE,
    "cosim.world.break_ups: _earlier_d: d = dict(zip(before.ids, before.d.tolist(), strict=True)): True → False #1": EQUAL_LENGTHS,
    "cosim.world.break_ups: with_cause: k = next((k for k, now in enumerate(trace) if now.time >= episode.end - 1e-6), len(trace) - 1): now.time >= episode.end - 1e-06, GtE → Gt #1": NOT_THAT_CLOSE,
    "cosim.world.break_ups: do_the_same: one.vehicle == other.vehicle and abs(one.time - other.time) <= SAME_TIME + 1e-6: abs(one.time - other.time) <= SAME_TIME + 1e-06, LtE → Lt #1": NOT_THAT_CLOSE,
    "cosim.world.break_ups: _recent: return tuple(entry for entry in found if episode.end - entry.time <= SAME_TIME + 1e-6): episode.end - entry.time <= SAME_TIME + 1e-06, LtE → Lt #1": NOT_THAT_CLOSE,
    "cosim.world.break_ups: _passed: if not {member, other} <= set(before.ids) & set(now.ids):: {member, other} <= set(before.ids) & set(now.ids), LtE → Lt #1": "there are two members and an outsider",
    "cosim.batch.group_statistics: headline: dict(zip(by, key if isinstance(key, tuple) else (key,), strict=True)): True → False #1": EQUAL_LENGTHS,
    "cosim.batch.group_statistics: differences: return dict(zip(BY_NAME, with_correction(tests), strict=True)): True → False #1": EQUAL_LENGTHS,
    "cosim.batch.execute: _Packing.ended: self._checked = True: True → False #1": "the same runs would be checked again; it saves time",
    "cosim.batch.store: BatchStore._link_tables: if path.name.removeprefix(\"run=\") not in present:: if path.name.removeprefix('run=') not in present: → always #1": "what is removed is linked again below",
    "cosim.runs.run_tables: _group: after = (episode.time > episode.end + 1e-6)[:, None] & episode.valid[:, :-1]: episode.time > episode.end + 1e-06, Gt → GtE #1": NOT_THAT_CLOSE,
    'cosim.runs.run_tables: _group: **_brakings(episode, episode.time > episode.end + 1e-6, "_after"),: episode.time > episode.end + 1e-06, Gt → GtE #1': NOT_THAT_CLOSE,
    "cosim.runs.run_tables: _inferred_graph_columns: for (i, j), kind, p in zip(reported, types, probabilities, strict=True):: True → False #1": EQUAL_LENGTHS,
    "cosim.runs.run_tables: graphs_table: strict=True,: True → False #1": EQUAL_LENGTHS,
    "cosim.runs.run_tables: graphs_table: for (i, j), k, p, in_doubt in zip(graph.pairs, types, probabilities, doubted, strict=True): True → False #1": EQUAL_LENGTHS,
    "gri.storage.claims: _claimed: os.truncate(handle, 0): 0 → 0 + 1 #1": "the record that follows is longer than a byte",
    "gri.storage.claims: _claimed: if fcntl is not None:: if fcntl is not None: → always #1": "for Windows only",
    "gri.storage.claims: _holder: record = json.loads(os.read(handle, 10_000)): 10000 → 10000 + 1 #1": "no record is as long",
    "gri.storage.verification: digest: if abs(time.time() - found.st_mtime) < JUST_NOW:: abs(time.time() - found.st_mtime) < JUST_NOW, Lt → LtE #1": "a file that is exactly that old may be read again or not",
    "gri.storage.verification: set_aside: names = (path.with_name(f\"{path.name}.damaged{f'-{k}' if k > 1 else ''}\") for k in range(1, 10**6)): 6 → 6 + 1 #1": "nobody has a million damaged files of one name",
    "gri.storage.whole_files: publish: for inner in sorted(part.rglob(\"*\")) if part.is_dir() else ():: sorted(part.rglob('*')) if part.is_dir() else () → always #1": "a file has no inner ones",
    "gri.storage.whole_files: _sync: handle = os.open(path, os.O_RDONLY if folder or os.name == \"posix\" else os.O_RDWR): os.O_RDONLY if folder or os.name == 'posix' else os.O_RDWR → always #1": "for Windows only",
    "gri.storage.whole_files: _sync: handle = os.open(path, os.O_RDONLY if folder or os.name == \"posix\" else os.O_RDWR): folder or os.name == 'posix', Or → And #1": "for Windows only: a handle for writing flushes as well",
    "gri.storage.whole_files: _sync: if folder:  # Windows opens no folders: if folder: → never #1": "for Windows only",
    'gri.storage.whole_files: _short: return name.encode()[:200].decode(errors="ignore"): 200 → 200 + 1 #1': "a name with one byte more fits as well",
}
"""By the key of a mutant (`session.keys_of`): why the program does the same."""
