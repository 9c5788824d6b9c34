"""Results on disk: written whole, claimed by one command at a time, compared with their hashes before they are used.

`whole_files` writes files and folders that appear whole or not at all, also after a crash of the machine. `claims`
keeps two commands out of one folder. `verification` notices damaged files. Everything that writes results may use them.
Begin reading at `whole_files`.
"""
