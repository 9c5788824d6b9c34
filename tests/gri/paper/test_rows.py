from gri.paper.rows import SCENARIOS, config_of, published_rows, rows_of


def test_every_car_following_row_has_a_configuration():
    scenario = SCENARIOS[0]
    assert [row.name for row in scenario.rows if config_of(scenario, row) is None] == []
    names = {row.name for row in rows_of(scenario, "table3")}
    assert names == {"GRI", "GRI (paper, contrast)", "GRI-VAIRL", "GRI-AIRL"}


def test_every_recorded_row_has_a_configuration_or_is_calibrated():
    recorded = [scenario for scenario in SCENARIOS if scenario.recorded]
    assert len(recorded) == 2
    for scenario in recorded:
        assert rows_of(scenario, "table2") == scenario.rows


def test_rows_stand_beside_published_ones():
    published = published_rows()
    for scenario in SCENARIOS:
        for row in scenario.rows:
            assert row.published is None or row.published in published.get(scenario.name, {})
    assert set(published) == {s.name for s in SCENARIOS if not s.name.endswith(("_mixed", "_noise", "_idm"))}
    assert published["car_following"]["NRI"].accuracy == (66.70, 0.0)
    assert published["lane_changing"]["GRI"].y == (0.207, 0.046)
