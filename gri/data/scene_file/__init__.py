"""The scene file: one Parquet table for scenes of every origin (docs/scenes.md).

`schema` defines the columns and writes the file; `cosim` and the other rooms of `gri.data` use `writing`, `joining`,
`SceneBlock`, `Header`, `header_of` and `names_of`. `reading` reads the scenes as tensors for a model (`read`). Begin
reading with `schema`.
"""
