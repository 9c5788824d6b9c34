"""What each relation asks of a vehicle: named reward terms and their weighted sum (Sec. IV).

Begin with `structured.StructuredReward`; `terms` lists the terms of each scenario, the `…_features` files hold their
formulas.
"""
