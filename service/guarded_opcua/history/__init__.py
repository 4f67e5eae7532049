"""What variables have been: who keeps it, and how it is read (Part 11)."""
