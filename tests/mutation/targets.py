"""Which modules are mutated, and which tests have to notice."""

TARGETS: dict[str, tuple[str, ...]] = {
    "cosim.measures.surrogate_safety": ("tests/cosim/measures/test_surrogate_safety.py",),
    "cosim.measures.collision_detection": ("tests/cosim/measures/test_collision_detection.py",),
    "cosim.measures.statistics": ("tests/cosim/measures/test_statistics.py",),
    "cosim.measures.sequential_test": ("tests/cosim/measures/test_sequential_test.py",),
    "cosim.measures.relation_labels": ("tests/cosim/measures/test_relation_labels.py",),
    "cosim.world.road_frame": ("tests/cosim/world/test_road_frame.py",),
    "cosim.world.contacts": ("tests/cosim/world/test_contacts.py",),
    "cosim.world.break_ups": ("tests/cosim/world/test_break_ups.py",),
    "cosim.batch.group_statistics": (
        "tests/cosim/batch/test_group_statistics.py",
        "tests/cosim/batch/test_result_listing.py",
    ),
    "cosim.batch.execute": ("tests/cosim/batch/test_execute.py", "tests/cosim/batch/test_shards.py"),
    "cosim.batch.store": (
        "tests/cosim/batch/test_store.py",
        "tests/cosim/batch/test_execute.py",
        "tests/cosim/batch/test_shards.py",
    ),
    "cosim.runs.run_tables": ("tests/cosim/runs/test_run_tables.py", "tests/cosim/runs/test_finished_run.py"),
    "gri.core.dynamics": ("tests/gri/core/test_dynamics.py",),
    "gri.rewards.terms": ("tests/gri/rewards/test_terms.py", "tests/gri/rewards/test_structured.py"),
    "gri.rewards.structured": ("tests/gri/rewards/test_structured.py",),
    "gri.rewards.car_following_features": ("tests/gri/rewards/test_car_following_features.py",),
    "gri.rewards.lane_changing_features": ("tests/gri/rewards/test_lane_changing_features.py",),
    "gri.storage.claims": ("tests/gri/storage/test_claims.py",),
    "gri.storage.verification": ("tests/gri/storage/test_verification.py",),
    "gri.storage.whole_files": ("tests/gri/storage/test_whole_files.py",),
}
