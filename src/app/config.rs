//! The settings file: composes what each room documents for itself.
