//! The service side: preparing a scene, dispatching tiles, assembling the image.
