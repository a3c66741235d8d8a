"""What is read of a robot's model: its contacts, its feet, and the memory that its contacts need."""
