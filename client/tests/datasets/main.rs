//! Generated logs written in the exact on-disk form of each data set, read back and compared.

mod street;

mod same_log;

mod nuscenes_files;

mod nuscenes;

mod argoverse_files;

mod argoverse;

mod waymo_files;

mod waymo;

mod kitti_files;

mod kitti;

mod sfm_files;

mod fuzz;

mod export;
