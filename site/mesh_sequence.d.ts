// Types of mesh_sequence.js: the plugin for three.js' GLTFLoader.
import { Material, Mesh, Object3D, WebGLRenderer } from "three";
import { GLTFLoaderPlugin, GLTFParser } from "three/addons/loaders/GLTFLoader.js";
import { DrawnMesh, Sequence } from "./mixseq.js";

/** loader.register((parser) => new MeshSequencePlugin(parser)) */
export class MeshSequencePlugin implements GLTFLoaderPlugin {
  readonly name: "MIXSEQ_mesh_sequence";
  constructor(parser: GLTFParser);
  loadMesh(number: number): Promise<MeshSequence> | null;
}

/** The mesh sequences in an object and all below it. */
export function meshSequences(object: Object3D): MeshSequence[];

/** A mesh that has the shape of a moment. */
export class MeshSequence extends Mesh {
  readonly isMeshSequence: true;
  readonly sequence: Sequence;
  constructor(sequence: Sequence, drawn: DrawnMesh, materials: Material[], polygons?: number[]);
  /** Seconds from the first frame to the last. */
  readonly duration: number;
  /** Take the shape of a moment, in seconds from the first frame; given the renderer, on its graphics card. */
  update(seconds: number, renderer?: WebGLRenderer | null): this;
}
