// The scene of a page that plays the first animation of a GLB: +Y up, metres.

import { GLTFLoader } from "gltf-loader";
import * as THREE from "three";

export async function show(glb, { scene }) {
  const { scene: tree, animations } = await new GLTFLoader().parseAsync(glb, "");
  scene.add(tree, new THREE.HemisphereLight("#ffffff", "#8a8068", 2));
  const box = new THREE.Box3().setFromObject(tree);
  const size = box.getSize(new THREE.Vector3()).length();
  const sun = new THREE.DirectionalLight("#fff4e0", 2.5);
  sun.position.set(-0.4, 1, 0.45).multiplyScalar(size);
  scene.add(sun);
  const floor = new THREE.MeshStandardMaterial({ color: "#c9c2ae" });
  const ground = new THREE.Mesh(new THREE.CircleGeometry(size, 64), floor);
  ground.rotation.x = -Math.PI / 2;
  ground.position.y = box.min.y;
  scene.add(ground);
  tree.traverse((part) => {
    part.frustumCulled = false; // bounds do not follow joints
  });
  const mixer = new THREE.AnimationMixer(tree);
  mixer.clipAction(animations[0]).play();
  const seek = (seconds) => mixer.setTime(seconds);
  return { box, view: new THREE.Vector3(0.42, 0.14, 0.9), up: new THREE.Vector3(0, 1, 0), seek, tree, mixer };
}
