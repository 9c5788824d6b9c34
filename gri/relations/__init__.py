"""What an edge means in terms of reactions, and the probability of each edge given how vehicles moved; without labels.

A vehicle's motion is explained by one reaction at a time: to a vehicle of the scene, to one that is not in the scene,
or to none. `closed_form_posterior` compares these explanations in closed form. Training and the benchmark use it.
`merge_posterior` does the same per step of a merge, where explanations change. Begin with `closed_form_posterior`.
"""
