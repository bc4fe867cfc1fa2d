//! Slot layout (field by field, to be written by the kd-tree's author).
