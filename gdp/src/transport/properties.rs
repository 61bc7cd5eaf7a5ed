//! What holds under any faults.
