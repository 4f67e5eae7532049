"""Names, units and sentences of everything that is published: tables, nothing else."""
