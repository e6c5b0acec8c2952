"""File name endings and limits by which uploads are classified before they are opened."""

MESH_SUFFIXES = (".obj", ".ply", ".glb", ".gltf", ".stl", ".off", ".3mf", ".dae")
POINT_SUFFIXES = (".xyz", ".txt", ".csv", ".asc", ".pts")
CLOUD_SUFFIXES = (".ply", ".splat", ".spz", ".sog", ".ksplat", ".glb", ".las", ".laz", ".pcd", *POINT_SUFFIXES)
SOG_FOLDER_FILE = "meta.json"  # of a splat in a folder of pictures
MASK_NAME = "mask.npy"  # of a cloud: one bool a Gaussian

PHOTO_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp")
MASKS = "masks"  # folder of the masks of photos
MIN_PHOTOS, MAX_PHOTOS = 8, 300
PHOTOS_OF_VIDEO = 40  # a walk of 360° at 9° per photo: neighbours match, and two cores match all pairs in minutes
