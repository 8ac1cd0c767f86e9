const module0=(()=>{
class MixseqError extends Error{
constructor(message){
super(message);
this.name="MixseqError";
}
}
function guarded(what,work){
try{
return work();
}catch(error){
const reason=error instanceof MixseqError?error.message:`${error.message}; it is damaged, or takes too much memory`;
throw new MixseqError(`${what}: ${reason}`);
}
}
return{MixseqError,guarded};
})();
const module1=(()=>{
const FAR=2047;
function logisticTables(){
const growth=new Float64Array(2*FAR + 1).fill(1),squash=new Int32Array(2*FAR + 1),stretch=new Int32Array(4096);
for(let x=0;x<FAR;x++)growth[FAR + x + 1]=growth[FAR + x]*1.0039138893383475;
for(let x=1;x<=FAR;x++)growth[FAR - x]=1 / growth[FAR + x];
growth.forEach((g,k)=>(squash[k]=Math.floor(65536*(g /(1 + g)))));
let x=0;
for(let p=0;p<4096;p++){
while(x<2*FAR&&squash[x]<16*p + 8)x++;
stretch[p]=x - FAR;
}
return{stretch,squash};
}
return{FAR,logisticTables};
})();
const module2=(()=>{
const{MixseqError}=module0;
const{FAR,logisticTables}=module1;
const QUEUES=16;
const INPUTS=8;
const SLOTS=1<<16,PATIENCE=255,RATE=32;
function mixedBits(queues,kinds,firstWeight){
const{stretch,squash}=logisticTables();
const contexts=new Int32Array(INPUTS),above=new Int32Array(INPUTS),heads=new Int32Array(QUEUES);
const shares=new Int32Array(INPUTS*SLOTS).fill(1<<23),places=new Int32Array(INPUTS);
const weights=new Float64Array(kinds*INPUTS).fill(firstWeight),logits=new Int32Array(INPUTS);
const steps=Int32Array.from({length:PATIENCE + 1},(_,seen)=>(1<<17)/(2*seen + 3));
function next(kind){
const first=kind*INPUTS;
let sum=0;
for(let i=0;i<INPUTS;i++){
const place=(i<<16)|(spread(contexts[i],above[i])>>>16),logit=stretch[shares[place]>>12];
places[i]=place;
logits[i]=logit;
sum+=weights[first + i]*logit;
}
const x=sum>=FAR*65536?FAR:sum<=-FAR*65536?-FAR:Math.floor(sum / 65536)|0;
const bit=taken((Math.abs(x)*QUEUES)>>11)^(x>0?1:0);
const error=RATE*(((bit<<16)- squash[x + FAR])>>4),aim=65535*bit;
for(let i=0;i<INPUTS;i++){
weights[first + i]+=(Math.imul(logits[i],error)+ 32768)>>16;
const place=places[i],share=shares[place],p=share>>8,seen=share&255;
shares[place]=((p +(Math.imul(aim - p,steps[seen])>>16))<<8)+(seen<PATIENCE?seen + 1:PATIENCE);
}
return bit;
}
function taken(queue){
if(heads[queue]>=queues[queue].length)throw new MixseqError("coded bits end early; the file is damaged");
return queues[queue][heads[queue]++];
}
return{contexts,above,next,plain:()=>taken(0),ended:()=>queues.every((queue,k)=>heads[k]===queue.length)};
}
function spread(low,high){
const first=low>>>16,second=low&0xffff;
const middle=Math.imul(first,0x7c15)+(Math.imul(second,0x7c15)>>>16),other=(middle&0xffff)+ Math.imul(second,0x7f4a);
const carried=Math.imul(first,0x7f4a)+(middle>>>16)+(other>>>16);
return carried + Math.imul(low,0x9e3779b9)+ Math.imul(high,0x7f4a7c15);
}
return{QUEUES,INPUTS,mixedBits,spread};
})();
const module3=(()=>{
const{MixseqError}=module0;
const WORD=2**32,WHOLE=2**24;
function symbolReader(bytes){
if(bytes.length % 4)throw new MixseqError("coded numbers end within a word; the file is damaged");
const words=new DataView(bytes.buffer,bytes.byteOffset,bytes.byteLength),state=new Float64Array(6);
let place=0;
state.set([WORD - 1,WORD - 1,nextWord(),nextWord()]);
function nextWord(){
place+=4;
return place>words.byteLength?0:words.getUint32(place - 4,true);
}
return function next(lefts){
const last=lefts.length - 2,scale=state[0]*256 + Math.floor(state[1]/ WHOLE),quotient=(state[2]*WORD + state[3])/ scale;
let symbol=0,high,low;
while(symbol<last&&lefts[symbol + 1]<=quotient)symbol++;
for(;;){
multiply(scale,lefts[symbol]);
high=state[2]- state[4];
low=state[3]- state[5];
if(low<0)[high,low]=[high - 1,low + WORD];
multiply(scale,lefts[symbol + 1]- lefts[symbol]);
if(high<0)symbol--;
else if(high<state[4]||(high===state[4]&&low<state[5]))break;
else if(++symbol>last)throw new MixseqError("coded numbers are damaged");
}
const more=!state[4];
state[0]=more?state[5]:state[4];
state[1]=more?0:state[5];
state[2]=more?low:high;
state[3]=more?nextWord():low;
return symbol;
};
function multiply(scale,number){
const first=Math.floor(scale / 65536),part=first*number,high=Math.floor(part / 65536);
const low=(part - high*65536)*65536 +(scale - first*65536)*number,carry=Math.floor(low / WORD);
state[4]=high + carry;
state[5]=low - carry*WORD;
}
}
class Tables{
constructor(magnitudes,largest){
this.size=2*largest + 2;
this.counts=new Float64Array(this.size*magnitudes.length).fill(1);
magnitudes.forEach((magnitude,context)=>{
const ratio=magnitude /(1 + magnitude),powers=[1];
for(let n=1;n<=largest;n++)powers.push(powers[n - 1]*ratio);
const shares=[...powers.slice(1).reverse(),...powers],whole=shares.reduce((sum,share)=>sum + share,0);
shares.forEach((share,symbol)=>(this.counts[context*this.size + symbol]+=Math.floor((512*share)/ whole)));
});
}
lefts(context){
const row=this.counts.subarray(context*this.size,(context + 1)*this.size);
const total=row.reduce((sum,count)=>sum + count,0),shares=Array.from(row,(count)=>count / total);
const scale=(WHOLE - this.size)/ shares.reduce((sum,share)=>sum + share,0),lefts=new Float64Array(this.size + 1);
let sum=0;
shares.forEach((share,symbol)=>{
lefts[symbol]=Math.floor(sum*scale)+ symbol;
sum+=share;
});
lefts[this.size]=WHOLE;
return lefts;
}
add(context,symbol,times){
this.counts[context*this.size + symbol]+=64*times;
}
forget(){
for(let start=0;start<this.counts.length;start+=this.size){
const row=this.counts.subarray(start,start + this.size);
while(row.reduce((sum,count)=>sum + count,0)>64*2048)row.forEach((count,k)=>(row[k]=Math.floor((count + 1)/ 2)));
}
}
}
return{symbolReader,Tables};
})();
const module4=(()=>{
const{QUEUES}=module2;
const{Tables,symbolReader}=module3;
const{MixseqError}=module0;
const FIRST_ROUND=1<<6,LONGEST_ROUND=1<<16,FEWEST_BYTES=1 /(1<<18);
function unpackQueues(bytes,least,most,what){
const{lengths,start}=readLengths(bytes,what),total=lengths.reduce((sum,length)=>sum + length,0);
if(total<least||total>most||total*FEWEST_BYTES>bytes.length)throw new MixseqError(`${total} bits are not as many as ${what} have; the file is damaged`);
const next=symbolReader(bytes.subarray(start)),tables=bitTables();
const queues=lengths.map((length)=>new Uint8Array(length)),longest=Math.max(...lengths);
for(let first=0,size=FIRST_ROUND;first<longest;first+=size,size=Math.min(2*size,LONGEST_ROUND)){
const lefts=queues.map((_,queue)=>tables.lefts(queue));
queues.forEach((queue,k)=>{
const last=Math.min(first + size,queue.length);
let ones=0;
for(let place=first;place<last;place++){
const symbol=next(lefts[k]);
if(symbol !==1&&symbol !==2)throw new MixseqError(`the bits of ${what} are damaged`);
queue[place]=symbol - 1;
ones+=symbol - 1;
}
tables.add(k,1,Math.max(last - first,0)- ones);
tables.add(k,2,ones);
});
tables.forget();
}
return queues;
}
function bitTables(){
const fall=1 - 1 / 2 + 1 / 8 - 1 / 48,ratios=[3 / 4];
while(ratios.length<QUEUES)ratios.push(ratios[ratios.length - 1]*fall);
return new Tables(ratios.map((ratio)=>ratio /(1 - ratio)),1);
}
function readLengths(bytes,what){
const lengths=[];
let number=0,unit=1;
for(let place=0;place<Math.min(bytes.length,10*QUEUES);place++){
number+=(bytes[place]&127)*unit;
unit*=128;
if(bytes[place]<128){
lengths.push(number);
if(lengths.length===QUEUES)return{lengths,start:place + 1};
[number,unit]=[0,1];
}
}
throw new MixseqError(`the bits of ${what} end early; the file is damaged`);
}
return{unpackQueues};
})();
const module5=(()=>{
const UNUSED=0;
const OPEN=1;
const CLOSED=2;
const INTO=0;
const OUT_OF=1;
const LOOKED_AT=33;
function noHalfEdges(cornerCount,vertexCount){
const two=(count)=>[new Int32Array(count).fill(-1),new Int32Array(count).fill(-1)];
const trees=[0,1,2].map(()=>new Int32Array(vertexCount + 1));
for(let at=1;at<=vertexCount;at++)trees[UNUSED][at]=at&-at;
return{
tails:new Int32Array(cornerCount),heads:new Int32Array(cornerCount),
newest:two(vertexCount),older:two(cornerCount),newer:two(cornerCount),
openEdges:new Int32Array(vertexCount),degrees:new Int32Array(vertexCount),states:new Uint8Array(vertexCount),
members:[vertexCount,0,0],trees,
unused:[-1,1].map((step)=>Int32Array.from({length:vertexCount + 2},(_,at)=>at + step)),
};
}
function rankOf({trees},state,vertex){
const tree=trees[state];
let rank=0;
for(;vertex>0;vertex&=vertex - 1)rank+=tree[vertex];
return rank;
}
function vertexOf({trees},state,rank){
const tree=trees[state];
let vertex=0;
for(let step=1<<(31 - Math.clz32(tree.length));step;step>>=1){
if(vertex + step<tree.length&&tree[vertex + step]<=rank){
vertex+=step;
rank-=tree[vertex];
}
}
return vertex;
}
function move({trees,states,members,unused},vertex,state){
const old=states[vertex],from=trees[old],to=trees[state];
if(old===state)return;
states[vertex]=state;
members[old]--;
members[state]++;
if(old===UNUSED){
const below=unused[0][vertex + 1],above=unused[1][vertex + 1];
unused[1][below]=above;
unused[0][above]=below;
}
for(let at=vertex + 1;at<to.length;at+=at&-at){
from[at]--;
to[at]++;
}
}
function addPolygon(mesh,corners,start,stop){
for(let corner=start;corner<stop;corner++)add(mesh,corner,corners[corner],corners[corner + 1<stop?corner + 1:start]);
for(let corner=start;corner<stop;corner++){
const vertex=corners[corner];
mesh.degrees[vertex]++;
move(mesh,vertex,mesh.openEdges[vertex]?OPEN:CLOSED);
}
}
function add(mesh,edge,tail,head){
const{tails,heads,openEdges}=mesh;
let other=mesh.newest[INTO][tail],looked=0;
while(other>=0&&tails[other]!==head)other=++looked<LOOKED_AT?mesh.older[INTO][other]:-1;
if(other>=0){
unlink(mesh,INTO,tail,other);
unlink(mesh,OUT_OF,head,other);
}else{
tails[edge]=tail;
heads[edge]=head;
link(mesh,INTO,head,edge);
link(mesh,OUT_OF,tail,edge);
}
openEdges[tail]+=other>=0?-1:1;
openEdges[head]+=other>=0?-1:1;
}
function link(mesh,way,vertex,edge){
const newest=mesh.newest[way][vertex];
mesh.older[way][edge]=newest;
if(newest>=0)mesh.newer[way][newest]=edge;
mesh.newest[way][vertex]=edge;
}
function unlink(mesh,way,vertex,edge){
const older=mesh.older[way][edge],newer=mesh.newer[way][edge];
if(older>=0)mesh.newer[way][older]=newer;
if(newer>=0)mesh.older[way][newer]=older;
else mesh.newest[way][vertex]=older;
}
return{UNUSED,OPEN,CLOSED,INTO,OUT_OF,noHalfEdges,rankOf,vertexOf,move,addPolygon};
})();
const module6=(()=>{
const{INPUTS,spread}=module2;
const{INTO,OUT_OF}=module5;
const GUESSES=16;
const BASES=9;
const REPEATS=1<<16,FACTOR=1000003,WORD=2**32;
function noPast(vertexCount){
const rows=(count,size)=>Array.from({length:count},()=>new Int32Array(size));
return{
guesses:new Float64Array(GUESSES),successes:rows(4,GUESSES),winners:rows(4,2),trail:new Int32Array(3),near:new Int32Array(6),
bases:new Int32Array(BASES),distances:[0,1,2].map(()=>rows(4,BASES)),named:new Int32Array(4),lastDistances:new Int32Array(3),
repeats:new Int32Array(REPEATS),about:new Int32Array(INPUTS),used:new Int32Array(vertexCount).fill(-1),
};
}
function makeGuesses({newest,older,tails,heads,unused},{guesses,near},place,before,first,lastNew){
guesses.fill(-1);
if(place===0){
for(let i=0;i<3;i++){
const into=newest[INTO][near[i]],out=newest[OUT_OF][near[i]];
if(into>=0)guesses[i]=tails[into];
if(out>=0)guesses[3 + i]=heads[out];
}
guesses[9]=2*near[0]- near[3];
}else{
let edge=newest[INTO][before];
for(let i=0;i<3&&edge>=0;i++,edge=older[INTO][edge])guesses[i]=tails[edge];
}
if(place===3){
let edge=newest[OUT_OF][first];
for(let i=3;i<6&&edge>=0;i++,edge=older[OUT_OF][edge])guesses[i]=heads[edge];
}
guesses[6]=unused[1][lastNew + 1]- 1;
guesses[7]=unused[0][lastNew + 1]- 1;
for(let i=0;i<3;i++)guesses[11 + i]=near[i];
guesses[14]=before + 1;
guesses[15]=before - 1;
}
function remember({guesses,successes,trail,winners},place,vertex,winner){
const right=successes[place];
for(let g=0;g<GUESSES;g++)if(guesses[g]>=0)right[g]=((right[g]<<1)|(guesses[g]===vertex?1:0))&255;
const here=winners[place];
trail[2]=trail[1];
trail[1]=trail[0];
here[1]=here[0];
trail[0]=here[0]=winner;
}
function slotOf(corners,corner,place){
const third=corners[corner - 2],second=corners[corner - 1],first=(corners[corner]- second)*FACTOR + second - third;
const high=Math.floor(first / WORD),low=(first - high*WORD)*FACTOR + third - corners[corner - 3],carry=Math.floor(low / WORD);
const lower=4*(low - carry*WORD)+ place;
return spread(lower,4*(high*FACTOR + carry)+ Math.floor(lower / WORD))&(REPEATS - 1);
}
return{GUESSES,BASES,noPast,makeGuesses,remember,slotOf};
})();
const module7=(()=>{
const{INPUTS,mixedBits}=module2;
const{unpackQueues}=module4;
const{BASES,GUESSES,makeGuesses,noPast,remember,slotOf}=module6;
const{MixseqError}=module0;
const{CLOSED,OPEN,UNUSED,addPolygon,move,noHalfEdges,rankOf,vertexOf}=module5;
const COUNTS=3,STATES=4;
const KINDS=4*GUESSES + 4*5,FIRST_WEIGHT=1<<14,LONGEST=33,LOOKED_AT=32;
function decodePolygons(bytes,polygonCount,cornerCount,vertexCount){
const whole=[polygonCount,cornerCount,vertexCount].every((count)=>count>=0&&count<2**31&&count % 1===0);
if(!whole||cornerCount<3*polygonCount)throw damaged();
if(!polygonCount||!vertexCount){
if(bytes.length||cornerCount)throw damaged();
return{counts:new Uint32Array(0),corners:new Uint32Array(0)};
}
const number=2 + 2*LONGEST,most=polygonCount*number + cornerCount*(GUESSES + 2*number);
const bits=mixedBits(unpackQueues(bytes,polygonCount + cornerCount,most,"the mesh"),KINDS,FIRST_WEIGHT);
const mesh={counts:new Uint32Array(polygonCount),corners:new Uint32Array(cornerCount)};
walk(bits,noHalfEdges(cornerCount,vertexCount),noPast(vertexCount),mesh.counts,mesh.corners);
if(!bits.ended())throw damaged();
return mesh;
}
const damaged=()=>new MixseqError("the mesh is damaged");
function walk(bits,mesh,past,counts,corners){
const{guesses,near}=past;
let corner=0,first=0,previous=0;
let lastNew=-1,repeat=0,run=0;
for(let polygon=0;polygon<counts.length;polygon++){
const start=corner,old=polygon?counts[polygon - 1]:3,older=polygon>1?counts[polygon - 2]:3;
past.about.fill((Math.min(old,63)<<6)|Math.min(older,63));
const count=old + readNumber(bits,past.about,COUNTS),stop=start + count;
if(count<3||stop>corners.length)throw damaged();
counts[polygon]=count;
for(;corner<stop;corner++){
const j=corner - start,place=corner===stop - 1?3:Math.min(j,2),before=corner?corners[corner - 1]:0;
makeGuesses(mesh,past,place,before,j?corners[start]:before,lastNew);
if(repeat)guesses[8]=before + corners[repeat]- corners[repeat - 1];
if(j&&first + j<start)guesses[9]=before + corners[first + j]- corners[first + j - 1];
if(j&&previous + j<first)guesses[10]=before + corners[previous + j]- corners[previous + j - 1];
const winner=readWinner(bits,mesh,past,corners,polygon,start,corner,place,run);
const vertex=winner<GUESSES?guesses[winner]:readNamed(bits,mesh,past,winner - GUESSES,before,place,lastNew);
corners[corner]=vertex;
remember(past,place,vertex,winner);
if(repeat&&guesses[8]===vertex){
repeat++;
run++;
}else repeat=run=0;
if(corner>2){
const slot=slotOf(corners,corner,place);
repeat||=past.repeats[slot];
past.repeats[slot]=corner + 1;
}
if(mesh.states[vertex]===UNUSED){
lastNew=vertex;
move(mesh,vertex,OPEN);
}
past.used[vertex]=polygon;
}
addPolygon(mesh,corners,start,stop);
near.copyWithin(3,0,3);
near.set([corners[start],corners[start + 1],corners[stop - 1]]);
previous=first;
first=start;
}
if(corner !==corners.length)throw damaged();
}
function readWinner(bits,mesh,past,corners,polygon,start,corner,place,run){
const{degrees,openEdges}=mesh,{guesses,trail,used}=past,{contexts,above}=bits;
const before=corner?corners[corner - 1]:0,first=corner>start?corners[start]:before;
const around=corner?Math.min(degrees[before],8)*4 + Math.min(openEdges[before],3):0;
const winners=past.winners[place],successes=past.successes[place];
for(let g=0;g<GUESSES;g++){
const guess=guesses[g];
if(guess<0||guess>=degrees.length)continue;
let agreeing=0,again=0;
for(let h=0;h<GUESSES;h++)if(guesses[h]===guess)agreeing|=1<<h;
if(agreeing&((1<<g)- 1))continue;
for(let other=Math.max(start,corner - LOOKED_AT);other<corner;other++)if(corners[other]===guess)again=1;
const kind=place*GUESSES + g,fan=(again*4 + Math.min(openEdges[guess],3))*9 + Math.min(degrees[guess],8);
const age=used[guess]>=0?bitLength(polygon - used[guess]):63,right=successes[g];
const long=(((agreeing<<5)|trail[0])<<7)|fan;
contexts[0]=(((right<<7)|(again?fan:0))<<7)|kind;
contexts[1]=(((agreeing<<1)|again)<<7)|kind;
contexts[2]=(((((trail[0]<<5)|trail[1])<<5)|trail[2])<<7)|kind;
contexts[3]=(((((winners[0]<<5)|winners[1])<<5)|trail[0])<<7)|kind;
contexts[4]=(((fan<<6)|around)<<7)|kind;
contexts[5]=(((((clamped(guess - before)<<6)|clamped(guess - first))<<5)|trail[0])<<7)|kind;
contexts[6]=(long<<7)|kind;
contexts[7]=(((((age<<4)|Math.min(run,15))<<3)|(right&7))<<7)|kind;
above.fill(0);
above[6]=long>>>25;
if(bits.next(kind))return g;
}
const{about}=past,last=winners[0],two=(((trail[0]<<5)|trail[1])<<2)|place;
[place,two,(last<<2)|place,(two<<5)|last].forEach((known,i)=>(about[i]=about[4 + i]=known));
const state=OPEN + readNumber(bits,about,STATES);
if(state<UNUSED||state>CLOSED)throw damaged();
return GUESSES + state;
}
function readNamed(bits,mesh,past,state,before,place,lastNew){
const{about,bases}=past,distances=past.distances[state][place],members=mesh.members[state];
bases[0]=lastNew + 1;
bases[1]=before;
bases[2]=past.named[place];
bases.set(past.near,3);
let best=0,second=1;
for(let base=1;base<BASES;base++){
if(distances[base]<distances[best])[best,second]=[base,best];
else if(distances[base]<distances[second])second=base;
}
const origin=rankOf(mesh,state,bases[best]),apart=rankOf(mesh,state,bases[second])- origin;
const last=(bitLength(past.lastDistances[state])<<2)|place,near=((Math.min(Math.max(apart,-7),7)+ 7)<<2)|place;
const far=(best<<7)|(bitLength(apart)<<1)|(apart<0?1:0);
const share=(Math.floor((origin*16)/(members + 1))<<6)|bitLength(members);
about.set([0,near,far,(far<<8)|near,last,(last<<8)|near,share,((distances[best]>>6)<<2)|place]);
const distance=readNumber(bits,about,state),rank=origin + distance;
if(rank<0||rank>=members)throw damaged();
past.lastDistances[state]=distance;
for(let base=0;base<BASES;base++)distances[base]+=(256*bitLength(rankOf(mesh,state,bases[base])- rank)- distances[base])>>4;
return(past.named[place]=vertexOf(mesh,state,rank));
}
function readNumber(bits,about,what){
const next=(stage,node,known)=>{
for(let i=0;i<INPUTS;i++){
bits.contexts[i]=(known?about[i]<<20:0)|(node<<5)|(what<<2)|stage;
bits.above[i]=(known?about[i]>>>12:0)|(1<<28);
}
return bits.next(4*(GUESSES + what)+ stage);
};
if(!next(0,0,true))return 0;
const negative=next(1,0,true);
let length=1,value=1;
while(next(2,(length<<1)|negative,true)&&length<LONGEST)length++;
for(let shift=length - 2;shift>=0;shift--)value=2*value + next(3,(length<<6)|(value<16?value:16 + shift),value<4);
return negative?-value:value;
}
const bitLength=(number)=>32 - Math.clz32(Math.abs(number));
const clamped=(number)=>Math.min(Math.max(number,-31),31)+ 32;
return{decodePolygons};
})();
const module8=(()=>{
function solved(rows,right){
const size=right.length;
for(let k=0;k<size;k++){
let best=k;
for(let i=k + 1;i<size;i++)if(Math.abs(rows[i][k])>Math.abs(rows[best][k]))best=i;
[rows[k],rows[best]]=[rows[best],rows[k]];
[right[k],right[best]]=[right[best],right[k]];
const own=rows[k];
for(let i=k + 1;i<size;i++){
const row=rows[i],share=row[k]/ own[k];
if(share===0)continue;
for(let j=k;j<size;j++)row[j]-=share*own[j];
right[i]-=share*right[k];
}
}
for(let k=size - 1;k>=0;k--){
for(let j=k + 1;j<size;j++)right[k]-=rows[k][j]*right[j];
right[k]/=rows[k][k];
}
return right;
}
const zeros=(size)=>Array.from({length:size},()=>new Float64Array(size));
return{solved,zeros};
})();
const module9=(()=>{
const{solved,zeros}=module8;
function splineWeights(knots,time,smooth){
const count=knots.length,end=count - 1,steps=knots.slice(1).map((knot,k)=>knot - knots[k]);
const system=zeros(count),right=zeros(count),set=(row,column,value)=>(system[column][row]=value);
set(0,0,1);
set(end,end,1);
for(let k=1;k<end;k++){
const before=steps[k - 1],after=steps[k];
set(k,k - 1,before);
set(k,k,2*(before + after));
set(k,k + 1,after);
right[k][k - 1]=6 / before;
right[k][k]=-6 / before - 6 / after;
right[k][k + 1]=6 / after;
}
if(smooth&&count>3){
[steps[1],-steps[0]- steps[1],steps[0]].forEach((value,k)=>set(0,k,value));
[steps[end - 2],-steps[end - 1]- steps[end - 2],steps[end - 1]].forEach((value,k)=>set(end,end - k,value));
}else if(smooth&&count===3){
set(0,1,-1);
set(2,1,-1);
}
let left=0;
while(left<end - 1&&knots[left + 1]<=time)left++;
const width=steps[left],after=(time - knots[left])/ width,before=1 - after,share=(width*width)/ 6;
const bends=new Float64Array(count),weights=new Float64Array(count);
bends[left]=(before**3 - before)*share;
bends[left + 1]=(after**3 - after)*share;
solved(system,bends).forEach((bend,k)=>right[k].forEach((value,j)=>(weights[j]+=bend*value)));
weights[left]+=before;
weights[left + 1]+=after;
return weights;
}
return{splineWeights};
})();
const module10=(()=>{
const{solved,zeros}=module8;
const{splineWeights}=module9;
const WINDOW=48;
class Operator{
constructor(times,{length,cubic}){
Object.assign(this,{times,length,cubic});
this.step=(times[times.length - 1]- times[0])/ Math.max(times.length - 1,1)||1;
}
at(time){
const{times,step,cubic}=this,count=times.length,size=Math.min(WINDOW,count);
const first=Math.min(Math.max(placeIn(times,time)-(size>>1),0),count - size);
const own=times.subarray(first,first + size);
if(size===1)return{first,weights:Float64Array.of(1)};
const knots=own.map((knot)=>(knot - own[0])/ step),wanted=(time - own[0])/ step;
const weights=this.length===null?splineWeights(knots,wanted,false):kriging(knots,wanted,this.length);
const share=count<3?0:time<times[1]?cubic[0]:time>times[count - 2]?cubic[1]:0;
if(share)splineWeights(knots,wanted,true).forEach((usual,k)=>(weights[k]+=share*(usual - weights[k])));
return{first,weights};
}
}
function placeIn(numbers,wanted){
let low=0,high=numbers.length;
while(low<high){
const middle=(low + high)>>1;
if(numbers[middle]<wanted)low=middle + 1;
else high=middle;
}
return low;
}
function kriging(knots,time,length){
const count=knots.length,mean=knots.reduce((sum,knot)=>sum + knot,0)/ count;
const covariance=(distance)=>{
const scaled=(Math.sqrt(3)*Math.abs(distance))/ length;
return(1 + scaled)*Math.exp(-scaled);
};
const trend=(at)=>(at - mean)/ count,system=zeros(count + 2),right=new Float64Array(count + 2);
knots.forEach((knot,k)=>{
knots.forEach((other,j)=>(system[k][j]=covariance(knot - other)));
system[k][count]=system[count][k]=1;
system[k][count + 1]=system[count + 1][k]=trend(knot);
right[k]=covariance(time - knot);
});
right[count]=1;
right[count + 1]=trend(time);
return solved(system,right).slice(0,count);
}
return{WINDOW,Operator,placeIn};
})();
const module11=(()=>{
const{Operator,placeIn}=module10;
const{splineWeights}=module9;
const REACH=24;
const KEPT=256;
class Curve{
constructor(times,between,width,row){
Object.assign(this,{times,width,row,operator:new Operator(times,between),middles:new Map()});
this.count=2*times.length - 1;
}
at(time){
const place=placeIn(this.times,time),{count}=this;
if(this.times[place]===time)return this.row(place);
const first=Math.max(2*place - 1 - REACH,0),end=Math.min(2*place + REACH,count);
const knots=Float64Array.from({length:end - first},(_,k)=>this.knot(first + k));
return this.sum(splineWeights(knots,time,true),(k)=>this.value(first + k));
}
knot(number){
const frame=number>>1;
return number&1?(this.times[frame]+ this.times[frame + 1])/ 2:this.times[frame];
}
value(number){
if(!(number&1))return this.row(number>>1);
let found=this.middles.get(number);
if(!found){
const{first,weights}=this.operator.at(this.knot(number));
found=this.sum(weights,(k)=>this.row(first + k));
this.middles.set(number,found);
if(this.middles.size>KEPT)this.middles.delete(this.middles.keys().next().value);
}
return found;
}
sum(weights,row){
const found=new Float64Array(this.width);
weights.forEach((weight,k)=>{
const values=row(k);
for(let i=0;i<found.length;i++)found[i]+=weight*values[i];
});
return found;
}
}
return{Curve};
})();
const module12=(()=>{
const TABLES=tables();
function tables(){
const found=Array.from({length:8},()=>new Uint32Array(256));
for(let byte=0;byte<256;byte++){
let code=byte;
for(let bit=0;bit<8;bit++)code=code&1?(code>>>1)^ 0xedb88320:code>>>1;
found[0][byte]=code;
}
for(let zeros=1;zeros<8;zeros++){
for(let byte=0;byte<256;byte++){
const before=found[zeros - 1][byte];
found[zeros][byte]=found[0][before&255]^(before>>>8);
}
}
return found;
}
function crc32(bytes,before=0){
const table=TABLES[0];
let code=~before;
for(let k=0;k<bytes.length;k++)code=table[(code ^ bytes[k])&255]^(code>>>8);
return ~code>>>0;
}
function crc32OfNumbers(numbers,before=0){
const[a,b,c,d,e,f,g,h]=TABLES;
let code=~before;
for(let k=0;k<numbers.length;k++){
const number=numbers[k],low=code ^ number,high=Math.floor(number / 4294967296)|0;
code=h[low&255]^ g[(low>>>8)&255]^ f[(low>>>16)&255]^ e[low>>>24]^
d[high&255]^ c[(high>>>8)&255]^ b[(high>>>16)&255]^ a[high>>>24];
}
return ~code>>>0;
}
return{crc32,crc32OfNumbers};
})();
const module13=(()=>{
const{crc32OfNumbers}=module12;
const{MixseqError}=module0;
const SIZE=4;
const checkOf=crc32OfNumbers;
function withoutCheck(bytes){
const end=Math.max(bytes.length - SIZE,0);
let expected=0;
for(let k=bytes.length - 1;k>=end;k--)expected=((expected<<8)|bytes[k])>>>0;
return{data:bytes.subarray(0,end),expected};
}
function refuseOthers(found,expected){
if(found !==expected)throw new MixseqError("coded numbers come out otherwise than they went in; it is damaged");
}
return{checkOf,withoutCheck,refuseOthers};
})();
const module14=(()=>{
const{MixseqError}=module0;
const MOST_PARTS=128;
const LARGEST_STEPS=2**26;
const LARGEST=2**32;
const PARAMETERS=[
"factors","rank","frame_count","step","diagonal","max_error","kg_percent","promised","correction","ranks","uv_steps",
"uv_error","revision",
];
const isCount=(value)=>Number.isInteger(value)&&value>0;
const isSize=(value)=>typeof value==="number"&&value>=0&&value<Infinity;
function readFacts(text){
const facts=parsed(text),given=facts.coding,strange=Object.keys(given).find((name)=>!PARAMETERS.includes(name));
if(strange !==undefined)throw new MixseqError(`this decoder does not know the parameter ${strange}; take a newer one`);
if((given.revision??1)===1)throw new MixseqError("it was compressed by an older mixseq; compress it again with this one");
const{vertex_count:vertices,polygon_count:polygons,corner_count:corners,frame_count:frames,fps}=facts;
const{factors,rank,ranks=[],uv_steps:steps=null,uv_error:error=null}=given,shapes=factors==="shapes";
const parts=Array.isArray(ranks)?ranks:[0];
const checks={
vertex_count:isCount(vertices),
polygon_count:Number.isInteger(polygons)&&polygons>=0,
corner_count:Number.isInteger(corners)&&corners>=3*polygons,
frame_count:isCount(frames)&&frames===given.frame_count,
factors:shapes||factors==="trajectories",
revision:given.revision===2,
rank:isCount(rank)&&rank<=3*Math.min(Math.max(parts.length,1)*frames,vertices)+ Math.max(parts.length,1),
ranks:parts.every(isCount)&&parts.length<=MOST_PARTS&&(!parts.length||(!shapes&&parts.reduce((a,b)=>a + b)===rank)),
step:isSize(given.step)&&given.step>0,
diagonal:isSize(given.diagonal)&&given.diagonal>0,
max_error:isSize(given.max_error),
kg_percent:isSize(given.kg_percent),
promised:typeof given.promised==="boolean",
correction:isSize(given.correction??0),
uv_steps:steps===null?error===null:isCount(steps)&&steps<=LARGEST_STEPS&&isSize(error),
fps:isSize(fps)&&fps>0,
first_time:Number.isFinite(facts.first_time),
};
const wrong=Object.keys(checks).find((name)=>!checks[name]);
if(wrong)throw new MixseqError(`${wrong} is not what it can be; it is damaged`);
const bytes=64*(vertices + frames)+ 320*corners + 16*rank*((shapes?3:1)*vertices +(shapes?9:3)*frames);
if(bytes>LARGEST)throw new MixseqError(`it would take ${Math.ceil(bytes / 2 ** 30)} GiB of memory, more than it may`);
return{
name:String(facts.name??""),fps,upAxis:String(facts.up_axis??"y"),metresPerUnit:Number(facts.metres_per_unit??1),
vertexCount:vertices,polygonCount:polygons,cornerCount:corners,frameCount:frames,firstTime:facts.first_time,
between:betweenOf(facts.between),
parameters:{
factors,rank,ranks:parts.length?parts:[rank],step:given.step,diagonal:given.diagonal,maxError:given.max_error,
kgPercent:given.kg_percent,promised:given.promised,correction:given.correction??0,uvSteps:steps,uvError:error,
},
};
}
function parsed(text){
let facts=null;
try{
facts=JSON.parse(text);
}catch{
}
const isObject=(value)=>typeof value==="object"&&value !==null&&!Array.isArray(value);
if(!isObject(facts)||!isObject(facts.coding))throw new MixseqError("the text of the coding is damaged, or of something else");
return facts;
}
function betweenOf(given){
if(given===undefined||given===null)return{length:null,cubic:[0.5,0.5]};
const{length,cubic,...others}=given;
const inside=(value,least,most)=>typeof value==="number"&&value>=least&&value<=most;
const shares=Array.isArray(cubic)&&cubic.length===2&&cubic.every((share)=>inside(share,0,1));
if(shares&&(length===null||inside(length,0.5,64))&&!Object.keys(others).length)return{length,cubic};
throw new MixseqError("between is not what it can be; it is damaged");
}
return{readFacts};
})();
const module15=(()=>{
function triangulated(counts,corners){
const faces=new Uint32Array(3*(corners.length - 2*counts.length));
let start=0,k=0;
for(const count of counts){
for(let corner=start + 1;corner<start + count - 1;corner++){
faces[k++]=corners[start];
faces[k++]=corners[corner];
faces[k++]=corners[corner + 1];
}
start+=count;
}
return faces;
}
return{triangulated};
})();
const module16=(()=>{
function evaluate({parts},weights,positions){
for(const{vertices,fields,values}of parts){
const count=fields.length,own=new Float64Array(3*count);
fields.forEach((field,k)=>own.set(weights.subarray(3*field,3*field + 3),3*k));
for(let i=0,at=0;i<vertices.length;i++){
let x=0,y=0,z=0;
for(let k=0;k<own.length;k+=3){
const value=values[at++];
x+=value*own[k];
y+=value*own[k + 1];
z+=value*own[k + 2];
}
const place=3*vertices[i];
positions[place]=x;
positions[place + 1]=y;
positions[place + 2]=z;
}
}
}
return{evaluate};
})();
const module17=(()=>{
const BEYOND=8;
class Bits{
constructor(data){
this.data=data;
this.place=4;
this.interval=Uint32Array.of(0,0xffffffff,(data[0]<<24)|(data[1]<<16)|(data[2]<<8)|data[3]);
}
read(chance){
const interval=this.interval;
let low=interval[0],high=interval[1],bit=1;
const range=(high - low)>>>0;
const part=Math.imul(range>>>16,chance)+(Math.imul(range&0xffff,chance)>>>16);
const middle=(low + part)>>>0;
if(interval[2]<=middle)high=middle;
else{
low=middle + 1;
bit=0;
}
while((low ^ high)>>>24===0){
low=(low<<8)>>>0;
high=((high<<8)|255)>>>0;
const place=this.place++;
interval[2]=(interval[2]<<8)|(place<this.data.length?this.data[place]:0);
}
interval[0]=low;
interval[1]=high;
return bit;
}
number(size){
let found=0;
for(let bit=0;bit<size;bit++)found=2*found + this.read(32768);
return found;
}
isBeyond(){
return this.place>this.data.length + BEYOND;
}
}
return{Bits};
})();
const module18=(()=>{
const{FAR,logisticTables}=module1;
const PATIENCE=255;
const RATE=48;
const LEAST=16;
const{stretch:STRETCH,squash:SQUASH}=logisticTables();
for(let x=0;x<SQUASH.length;x++)SQUASH[x]=Math.min(Math.max(SQUASH[x],LEAST),65536 - LEAST);
const STEPS=Int32Array.from({length:PATIENCE + 1},(_,count)=>Math.floor((1<<17)/(2*count + 3)));
const TRUST=Int32Array.from({length:PATIENCE + 1},(_,count)=>Math.floor((256*count)/(count + 1)));
class BitModels{
constructor(inputs,contexts,positions){
this.positions=positions;
this.width=contexts*positions;
this.shares=new Int32Array(inputs*this.width).fill(1<<23);
this.weights=new Float64Array(positions*inputs).fill(Math.floor((65536 +(inputs>>1))/ inputs));
this.contexts=new Int32Array(inputs);
this.inputs=new Int32Array(inputs);
this.places=new Int32Array(inputs);
}
read(bits,position){
const{shares,weights,contexts,inputs,places,positions,width}=this;
const count=inputs.length,own=position*count;
let sum=0;
for(let i=0,first=position;i<count;i++,first+=width){
const place=first + contexts[i]*positions,share=shares[place];
const x=(STRETCH[share>>12]*TRUST[share&255])>>8;
places[i]=place;
inputs[i]=x;
sum+=weights[own + i]*x;
}
const x=sum>=FAR*65536?FAR:sum<-FAR*65536?-FAR:sum>>16;
const chance=SQUASH[x + FAR],bit=bits.read(chance);
const error=((bit<<16)- chance)>>4,aim=(bit<<16)- bit;
for(let i=0;i<count;i++){
weights[own + i]+=(Math.imul(inputs[i],error)*RATE + 32768)>>16;
const place=places[i],share=shares[place],seen=share&255;
const p=(share>>8)+(Math.imul(aim -(share>>8),STEPS[seen])>>16);
shares[place]=(p<<8)+(seen<PATIENCE?seen + 1:seen);
}
return bit;
}
}
return{BitModels};
})();
const module19=(()=>{
const UNIT=64;
const FARTHEST=2**50;
const ROUNDING=1.5*2**28;
const LEAST=1e-12;
function predict(node,{width,neighbours,counts,weights},values){
let total=0.5;
for(let at=node*width,end=at + counts[node];at<end;at++)total+=weights[at]*values[neighbours[at]];
if(total>FARTHEST)total=FARTHEST;
else if(!(total>-FARTHEST))total=-FARTHEST;
return Math.floor(total);
}
const rounded=(weights)=>weights.map((weight)=>weight + ROUNDING - ROUNDING);
function trust(values,rough,{width,neighbours,counts}){
let total=0,pairs=0,share=1;
for(let node=0;node<values.length;node++){
if(!counts[node])continue;
const apart=values[node]- values[neighbours[node*width]];
total+=apart*apart;
pairs++;
}
const whole=rough*pairs;
total+=whole;
while(share*total>1.5*whole)share*=0.5;
return share;
}
const entries=(count)=>(count>1?(count*(count + 1))/ 2 - 1:0);
function learn(signals,trusts,{width,neighbours,counts},gram){
const apart=new Float64Array(width),size=counts.length;
for(let node=0,place=0;node<size;node++){
const last=counts[node]- 1,row=node*width;
if(last<1)continue;
for(let k=0;k<signals.length;k++){
const values=signals[k],weight=trusts[k],first=values[neighbours[row]];
for(let i=0;i<last;i++)apart[i]=values[neighbours[row + i + 1]]- first;
apart[last]=values[node]- first;
for(let i=0,at=place;i<=last;i++){
const one=weight*apart[i],end=i<last?i + 1:last;
for(let j=0;j<end;j++)gram[at++]+=one*apart[j];
}
}
place+=entries(last + 1);
}
}
function solve(ridge,{width,counts},gram,start,weights){
const columns=new Float64Array(width*width),row=new Float64Array(width);
const inverse=new Float64Array(width),found=new Float64Array(width);
for(let node=0,place=0;node<counts.length;node++){
const last=counts[node]- 1,first=node*width;
if(last<1)continue;
let pull=ridge;
for(let i=0;i<last;i++)pull+=LEAST*gram[place +(i*(i + 3))/ 2];
for(let i=0;i<=last;i++){
const end=i<last?i + 1:last;
for(let j=0;j<end;j++)row[j]=gram[place++]+ pull;
if(i<last)row[i]+=pull;
else for(let j=0;j<last;j++)row[j]+=pull*(start[first + j + 1]- start[first]);
for(let k=0;k<last&&k<i;k++){
const share=row[k]*inverse[k],column=k*width;
columns[column + i]=share;
for(let j=k + 1;j<end;j++)row[j]-=share*columns[column + j];
}
if(i<last)inverse[i]=1 / Math.sqrt(row[i]>pull?row[i]:pull);
}
let left=1;
for(let i=last - 1;i>=0;i--){
const column=i*width;
let entry=columns[column + last];
for(let k=i + 1;k<last;k++)entry-=columns[column + k]*found[k];
found[i]=entry*inverse[i]+ ROUNDING - ROUNDING;
left-=found[i];
}
weights[first]=left;
for(let i=0;i<last;i++)weights[first + i + 1]=found[i];
}
}
function nearest(signals,{width,neighbours,counts},exhaustive,most){
const size=counts.length,dim=signals.length,similar=new Int32Array(size*most),found=new Int32Array(size);
const points=new Float64Array(size*dim),seen=new Int32Array(size).fill(-1);
const apart=new Float64Array(most),distances=new Float64Array(Math.min(size,exhaustive));
for(let axis=0;axis<dim;axis++){
for(let node=0;node<size;node++)points[node*dim + axis]=signals[axis][node];
}
const look=(node,other)=>{
if(seen[other]===node)return;
seen[other]=node;
const farthest=apart[most - 1];
let distance=0;
for(let a=node*dim,b=other*dim,end=a + dim;a<end;a++,b++){
const one=points[a]- points[b];
distance+=one*one;
if(distance>=farthest)return;
}
insert(node,other,distance);
};
const insert=(node,other,distance)=>{
const row=node*most;
let place=most - 1;
for(;place>0&&apart[place - 1]>distance;place--){
apart[place]=apart[place - 1];
similar[row + place]=similar[row + place - 1];
}
apart[place]=distance;
similar[row + place]=other;
if(found[node]<most)found[node]++;
};
for(let node=0;node<size;node++){
const first=node*width,end=first + counts[node];
apart.fill(Infinity);
for(let at=first;at<end;at++)seen[neighbours[at]]=node;
if(node<exhaustive){
distancesBefore(signals,node,distances);
for(let other=0;other<node;other++){
if(distances[other]<apart[most - 1]&&seen[other]!==node)insert(node,other,distances[other]);
}
continue;
}
for(let at=first;at<end;at++){
const beside=neighbours[at];
for(let j=0;j<counts[beside];j++)look(node,neighbours[beside*width + j]);
for(let j=0;j<found[beside];j++)look(node,similar[beside*most + j]);
}
}
return{similar,found};
}
function distancesBefore(signals,node,distances){
distances.fill(0,0,node);
for(const signal of signals){
const here=signal[node];
for(let other=0;other<node;other++){
const one=signal[other]- here;
distances[other]+=one*one;
}
}
}
return{UNIT,predict,rounded,trust,entries,learn,solve,nearest};
})();
const module20=(()=>{
const{UNIT,entries,learn,nearest,rounded,solve,trust}=module19;
const SIMILAR=8,SIMILAR_FRAMES=16;
const SEARCHED=5;
const EXHAUSTIVE=2048;
const RIDGE=0.5;
const ROUGH=10;
const DOUBLED=16,AGES=512;
const SELDOM=2;
const FINER=9,FINEST=38;
const EQUAL=3;
class Predictor{
constructor(graph,stencil,coordinates){
const size=graph.order.length;
this.graph=graph;
this.searched=SEARCHED*coordinates;
this.equal=graph.overTime?Infinity:EQUAL*coordinates;
this.known=0;
this.due=1;
this.pending=[];
this.signals=[];
this.values=new Float64Array(size);
this.steps=new Float64Array(size).fill(UNIT);
this.join(stencil);
}
join({width,neighbours,counts,weights}){
this.start=rounded(weights);
this.from={width,neighbours,counts,weights:this.start.slice()};
this.gram=new Float64Array(counts.reduce((sum,count)=>sum + entries(count),0));
this.ridge=0;
}
finish(){
const signal=this.values.slice(),known=++this.known;
this.pending.push(signal);
if(known===this.equal)this.steps=finerSteps(this.steps.length);
if(known<=this.searched)this.signals.push(signal);
if(known===this.searched)this.joinSimilar();
if(known===this.searched||known>=this.due){
this.renew();
this.due=known + Math.max(1,known>>SELDOM);
}
}
renew(){
const{from,pending,gram}=this,first=this.known - pending.length;
const trusts=pending.map((signal,k)=>{
let share=trust(signal,ROUGH*UNIT*UNIT,from);
for(let age=Math.min(Math.floor((first + k)/ DOUBLED),AGES);age>0;age--)share*=2;
return share;
});
this.ridge+=RIDGE*UNIT*UNIT*trusts.reduce((sum,one)=>sum + one,0);
learn(pending,trusts,from,gram);
solve(this.ridge,from,gram,this.start,from.weights);
this.pending=[];
}
joinSimilar(){
const{graph,signals}=this,most=graph.overTime?SIMILAR_FRAMES:SIMILAR;
this.join(withMore(graph,nearest(signals,graph,EXHAUSTIVE,most),most));
this.pending=signals;
this.signals=[];
}
}
function withMore(graph,{similar,found},most){
const size=graph.order.length,width=graph.width + most;
const neighbours=new Int32Array(size*width),weights=new Float64Array(size*width);
const counts=graph.counts.map((count,node)=>count + found[node]);
for(let node=0;node<size;node++){
const own=graph.counts[node],row=node*width;
for(let i=0;i<own;i++){
neighbours[row + i]=graph.neighbours[node*graph.width + i];
weights[row + i]=graph.weights[node*graph.width + i];
}
for(let i=0;i<found[node];i++)neighbours[row + own + i]=similar[node*most + i];
}
return{width,neighbours,counts,weights};
}
function finerSteps(size){
const steps=new Float64Array(size).fill(UNIT);
for(let first=size>>1,step=UNIT;first;first>>=1){
step=Math.max(Math.floor((step*FINER)/ 10),FINEST);
steps.fill(step,0,first);
}
return steps;
}
return{Predictor};
})();
const module21=(()=>{
const{UNIT,predict}=module19;
const LEVELS=32;
const FINE_LEVELS=55;
const DEPTHS=18;
const AGES=8;
const LONGEST=24,MOST=55;
const LARGEST=2**40;
const INPUTS=5;
const CONTEXTS=LEVELS*LEVELS;
const POSITIONS=2*LONGEST;
const POWERS=new Float64Array(MOST).fill(1);
for(let bits=1;bits<MOST;bits++)POWERS[bits]=2*POWERS[bits - 1];
function readSignal(bits,models,known,{from,values,steps},numbers,activity,around){
const{width,neighbours,counts}=from,contexts=models.contexts,age=Math.min(level(known),AGES - 1);
for(let node=0,depth=0;node<values.length;node++){
while(depth<DEPTHS - 1&&node>>depth)depth++;
const count=counts[node],active=activity[node];
let size=active;
if(count){
let total=0;
for(let at=node*width,end=at + count;at<end;at++)total+=magnitude(numbers[neighbours[at]]);
size=Math.floor((UNIT*total)/ count);
}
const expected=Math.floor((205*size + 102*active + 38*around[node])/ 256);
const here=level(size)*LEVELS,beside=level(active);
contexts[0]=here + beside;
contexts[1]=beside*LEVELS + level(around[node]);
contexts[2]=fineLevel(expected)*DEPTHS + depth;
contexts[3]=here + level(UNIT*magnitude(numbers[node]));
contexts[4]=level(expected)*AGES + age;
const number=readSigned(bits,models);
numbers[node]=number;
values[node]=predict(node,from,values)+ steps[node]*number;
}
}
function readSigned(bits,models){
let size=0,value=1;
while(size<LONGEST&&models.read(bits,size))size++;
if(size===LONGEST)while(size<MOST&&bits.number(1))size++;
if(size===0)return 0;
if(size>1){
const top=models.read(bits,LONGEST + Math.min(size,LONGEST)- 2);
value=(2 + top)*POWERS[size - 2]+ bits.number(size - 2);
}
return bits.number(1)?-value:value;
}
const magnitude=(number)=>Math.min(Math.abs(number),LARGEST);
function level(size){
if(size<2)return size;
if(size>=65536)return LEVELS - 1;
const bits=32 - Math.clz32(size);
return 2*(bits - 1)+((size>>(bits - 2))&1);
}
function fineLevel(size){
if(size<4)return size;
if(size>=32768)return FINE_LEVELS;
const bits=32 - Math.clz32(size);
return 4*(bits - 2)+((size>>(bits - 3))&3);
}
function learnSizes(numbers,{ring,ringStarts},activity,around){
for(let node=0;node<numbers.length;node++){
activity[node]=Math.floor((102*activity[node]+ 154*UNIT*magnitude(numbers[node]))/ 256);
}
for(let node=0;node<numbers.length;node++){
const first=ringStarts[node],last=ringStarts[node + 1];
let total=0;
for(let place=first;place<last;place++)total+=activity[ring[place]];
around[node]=last>first?Math.floor(total /(last - first)):0;
}
}
return{INPUTS,CONTEXTS,POSITIONS,readSignal,learnSizes};
})();
const module22=(()=>{
const{Bits}=module17;
const{BitModels}=module18;
const{checkOf,refuseOthers,withoutCheck}=module13;
const{MixseqError}=module0;
const{Predictor}=module20;
const{CONTEXTS,INPUTS,POSITIONS,learnSizes,readSignal}=module21;
class Reader{
constructor(stream){
const{data,expected}=withoutCheck(stream);
this.coded=new Bits(data);
this.expected=expected;
this.check=0;
}
bits(){
if(this.coded.isBeyond())throw new MixseqError("coded numbers end early; it is damaged");
return this.coded;
}
checked(numbers){
this.check=checkOf(numbers,this.check);
}
finish(){
refuseOthers(this.check,this.expected);
}
}
const numberModels=()=>new BitModels(INPUTS,CONTEXTS,POSITIONS);
class SignalCoder{
constructor(graph,stencil,coordinates,models){
const size=graph.order.length;
this.graph=graph;
this.models=models;
this.predictor=new Predictor(graph,stencil,coordinates);
this.numbers=new Float64Array(size);
this.activity=new Float64Array(size);
this.around=new Float64Array(size);
this.known=0;
}
read(reader){
const{graph,predictor,numbers,activity,around}=this,values=new Float64Array(numbers.length);
readSignal(reader.bits(),this.models,this.known++,predictor,numbers,activity,around);
reader.checked(predictor.values);
for(let node=0;node<values.length;node++)values[graph.order[node]]=predictor.values[node];
learnSizes(numbers,graph,activity,around);
predictor.finish();
return values;
}
}
return{Reader,numberModels,SignalCoder};
})();
const module23=(()=>{
const MOST=12;
const HUB=32;
function adjacency(ends,others,size,count){
const starts=new Int32Array(count + 1);
for(let k=0;k<size;k++){
starts[ends[k]+ 1]++;
starts[others[k]+ 1]++;
}
for(let node=0;node<count;node++)starts[node + 1]+=starts[node];
const loose=new Int32Array(2*size),beside=new Int32Array(2*size);
let places=starts.slice();
for(let k=0;k<size;k++){
loose[places[ends[k]]++]=others[k];
loose[places[others[k]]++]=ends[k];
}
places=starts.slice();
for(let node=0;node<count;node++){
for(let at=starts[node];at<starts[node + 1];at++)beside[places[loose[at]]++]=node;
}
let kept=0;
for(let node=0,first=0;node<count;node++){
const end=starts[node + 1];
for(let at=first,last=node;at<end;at++){
const other=beside[at];
if(other===last||other===node)continue;
beside[kept++]=last=other;
}
first=end;
starts[node + 1]=kept;
}
return{starts,beside:beside.slice(0,kept)};
}
function byDegree(starts,count){
let most=0;
for(let node=0;node<count;node++)most=Math.max(most,starts[node + 1]- starts[node]);
const places=new Int32Array(most + 2);
for(let node=0;node<count;node++)places[starts[node + 1]- starts[node]+ 1]++;
for(let degree=0;degree<=most;degree++)places[degree + 1]+=places[degree];
const alone=places[1],nodes=new Int32Array(count - alone);
for(let node=0;node<count;node++){
const degree=starts[node + 1]- starts[node];
if(degree)nodes[places[degree]++ - alone]=node;
}
return nodes;
}
function independent(nodes,starts,beside,most){
const blocked=new Uint8Array(starts.length - 1),chosen=new Int32Array(nodes.length);
let count=0;
for(let k=0;k<nodes.length;k++){
const node=nodes[k];
if(blocked[node]||starts[node + 1]- starts[node]>most)continue;
chosen[count++]=node;
for(let at=starts[node];at<starts[node + 1];at++)blocked[beside[at]]=1;
}
return chosen.slice(0,count);
}
function collapse(gone,starts,beside,neighbours,counts){
let size=0;
for(const node of gone)size+=starts[node + 1]- starts[node];
const ends=new Int32Array(size),others=new Int32Array(size),mark=new Int32Array(starts.length - 1).fill(-1);
let count=0;
for(const node of gone){
const first=starts[node],last=starts[node + 1];
counts[node]=Math.min(last - first,MOST);
for(let i=0;i<counts[node];i++)neighbours[node*MOST + i]=beside[first + i];
for(let at=first;at<last;at++)mark[beside[at]]=node;
let best=beside[first],sharedBest=-1,degreeBest=0;
for(let place=first;place<last;place++){
const other=beside[place],low=starts[other],high=starts[other + 1],degree=high - low;
let shared=0;
if(degree>HUB*(last - first)){
for(let at=first;at<last;at++)if(find(beside,low,high,beside[at])>=0)shared++;
}else{
for(let at=low;at<high;at++)if(mark[beside[at]]===node)shared++;
}
if(shared>sharedBest||(shared===sharedBest&&degree<degreeBest)){
best=other;
sharedBest=shared;
degreeBest=degree;
}
}
for(let at=first;at<last;at++){
if(beside[at]===best)continue;
ends[count]=best;
others[count++]=beside[at];
}
}
return{ends:ends.slice(0,count),others:others.slice(0,count)};
}
function find(list,low,high,number){
while(low<high){
const middle=(low + high)>>1;
if(list[middle]<number)low=middle + 1;
else if(list[middle]>number)high=middle;
else return middle;
}
return -1;
}
return{MOST,adjacency,byDegree,independent,collapse,find};
})();
const module24=(()=>{
const{BitModels}=module18;
const{MOST:NEIGHBOURS}=module23;
const VOTES=NEIGHBOURS + 1;
const LONGEST=8,MOST=62;
const INPUTS=3,CONTEXTS=3*VOTES*VOTES,POSITIONS=4 + LONGEST;
const residualModels=()=>new BitModels(INPUTS,CONTEXTS,POSITIONS);
const emptyFrame=(size)=>({numbers:new Float64Array(3*size),displaced:new Uint8Array(size)});
function readFrame(bits,models,{width,neighbours,counts,ring,ringStarts},last){
const contexts=models.contexts.fill(0),frame=emptyFrame(counts.length),{numbers,displaced}=frame;
if(!models.read(bits,0))return frame;
const sums=new Int32Array(3);
for(let node=0;node<counts.length;node++){
const count=counts[node],own=last.displaced[node];
let votes=0,before=0,known=0;
sums.fill(0);
for(let at=node*width,end=at + count;at<end;at++){
const beside=neighbours[at];
if(!displaced[beside])continue;
votes++;
for(let k=0;k<3;k++)sums[k]+=Math.sign(numbers[3*beside + k]);
}
for(let place=ringStarts[node];place<ringStarts[node + 1];place++)before+=last.displaced[ring[place]];
const was=own?2:Math.min(before,1);
contexts[0]=(votes*VOTES + count)*3 + was;
contexts[1]=(Math.min(before,VOTES - 1)*VOTES + Math.min(votes,3))*2 + own;
contexts[2]=Math.min(votes,3)*3 + was;
if(!models.read(bits,1))continue;
for(let k=0;k<3;k++){
const here=limited(last.numbers[3*node + k])+ 3,around=limited(sums[k])+ 3;
contexts[0]=here*7 + around;
contexts[1]=(known*7 + around)*3 + k;
contexts[2]=(known*7 + here)*3 + k;
const number=readCoordinate(bits,models);
numbers[3*node + k]=number;
if(number)known|=1<<k;
}
displaced[node]=known?1:0;
}
return frame;
}
function readCoordinate(bits,models){
if(!models.read(bits,2))return 0;
const negative=models.read(bits,3);
let found=0;
while(found<LONGEST&&models.read(bits,4 + found))found++;
if(found===LONGEST){
let length=0;
while(length<MOST&&bits.number(1))length++;
found+=bits.number(length);
}
return negative?-(found + 1):found + 1;
}
const limited=(number)=>Math.min(Math.max(number,-3),3);
return{residualModels,emptyFrame,readFrame};
})();
const module25=(()=>{
const{MixseqError,guarded}=module0;
const{placeIn}=module10;
const{Reader}=module22;
const{emptyFrame,readFrame,residualModels}=module24;
const RUN=16;
const KEPT=8;
const NEAR=1e-9;
class ResidualLayer{
constructor(times,chunks,graph,unit){
Object.assign(this,{times,chunks,graph,unit});
this.runs=new Map();
}
addTo(positions,time){
const{frame,share}=placeOf(this.times,time);
const before=this.addFrame(positions,frame,1 - share);
return(share>0&&this.addFrame(positions,frame + 1,share))||before;
}
addFrame(positions,frame,share){
const{vertices,numbers}=this.frame(frame),unit=share*this.unit;
for(let i=0;i<vertices.length;i++){
for(let axis=0;axis<3;axis++)positions[3*vertices[i]+ axis]+=unit*numbers[3*i + axis];
}
return vertices.length>0;
}
frame(frame){
const chunk=this.chunks.find(({first,count})=>frame<first + count);
const number=Math.floor((frame - chunk.first)/ RUN),key=chunk.first + number*RUN;
let run=this.runs.get(key);
if(!run){
run=guarded(`the residuals of frames ${key} and on`,()=>readResiduals(chunk,number,this.graph));
this.runs.set(key,run);
if(this.runs.size>KEPT)this.runs.delete(this.runs.keys().next().value);
}
return run[frame - key];
}
}
function placeOf(times,time){
const after=placeIn(times,time),share=after&&(time - times[after - 1])/(times[after]- times[after - 1]);
if(!after||share>1 - NEAR)return{frame:after,share:0};
return{frame:after - 1,share:share<NEAR?0:share};
}
function readResiduals({count,residuals},run,graph){
const frames=Math.min(RUN,count - run*RUN),runs=Math.ceil(count / RUN),nothing={vertices:[],numbers:[]};
let start=4*runs,from=0,to=0;
if(!residuals.length)return new Array(frames).fill(nothing);
const view=new DataView(residuals.buffer,residuals.byteOffset,residuals.length);
for(let k=0;k<runs&&start<=residuals.length;k++){
from=k===run?start:from;
start+=view.getUint32(4*k,true);
to=k===run?start:to;
}
if(start !==residuals.length)throw new MixseqError("a residual layer has another length than it says; it is damaged");
return from===to?new Array(frames).fill(nothing):readRun(residuals.subarray(from,to),frames,graph);
}
function readRun(stream,count,graph){
const reader=new Reader(stream),models=residualModels(),frames=[];
let last=emptyFrame(graph.order.length);
for(let frame=0;frame<count;frame++){
last=readFrame(reader.bits(),models,graph,last);
reader.checked(last.numbers);
frames.push(residualsOf(last,graph.order));
}
reader.finish();
return frames;
}
function residualsOf({numbers,displaced},order){
const nodes=[];
for(let node=0;node<order.length;node++)if(displaced[node])nodes.push(node);
return{
vertices:Uint32Array.from(nodes,(node)=>order[node]),
numbers:Float64Array.from({length:3*nodes.length},(_,k)=>numbers[3*nodes[Math.floor(k / 3)]+(k % 3)]),
};
}
return{ResidualLayer};
})();
const module26=(()=>{
const{MOST,adjacency,byDegree,collapse,independent}=module23;
const WIDEST=6;
const ROOTS=6;
function meshGraph(triangles,count){
const size=triangles.length,ends=new Int32Array(size),others=new Int32Array(size);
for(let k=0;k<size;k++){
ends[k]=triangles[k];
others[k]=triangles[k % 3===2?k - 2:k + 1];
}
const fine=adjacency(ends,others,size,count);
const neighbours=new Int32Array(count*MOST),counts=new Int32Array(count);
const levels=coarserLevels(fine,count,neighbours,counts);
const order=new Int32Array(count),left=new Uint8Array(count).fill(1);
for(const{gone}of levels)for(const node of gone)left[node]=0;
let roots=0;
for(let node=0;node<count;node++)if(left[node])order[roots++]=node;
for(let place=1;place<roots;place++){
const node=order[place],first=Math.max(0,place - ROOTS);
counts[node]=place - first;
for(let k=first;k<place;k++)neighbours[node*MOST + k - first]=order[k];
}
for(let level=levels.length - 1,place=roots;level>=0;level--){
order.set(levels[level].gone,place);
place+=levels[level].gone.length;
}
const weights=new Float64Array(count*MOST);
for(let node=0;node<count;node++){
for(let i=0;i<counts[node];i++)weights[node*MOST + i]=1 / counts[node];
}
return{graph:inOrder(order,neighbours,counts,weights,MOST,fine,false),levels};
}
function pathGraph(count){
const width=6,last=count - 1;
const neighbours=new Int32Array(count*width),counts=new Int32Array(count);
const weights=new Float64Array(count*width),order=new Int32Array(count);
let done=1;
if(count>1){
order[done++]=last;
counts[last]=1;
weights[last*width]=1;
}
let step=1;
while(step<last)step*=2;
for(step /=2;step>=1;step /=2){
const multiples=Math.ceil(last /(2*step)),known=(k)=>(k<multiples?k*2*step:last);
for(let node=step;node<last;node+=2*step){
const place=(node - step)/(2*step)+ 1,first=Math.max(place - 2,0),end=Math.min(place + 2,multiples + 1);
const beside=[],others=[];
for(let k=first;k<end;k++)beside.push(known(k));
for(let k=first - 1;k>=Math.max(first - width,0);k--)others.push(known(k));
for(let k=end;k<Math.min(end + width,multiples + 1);k++)others.push(known(k));
for(let k=1;k<=width&&node - 2*k*step>0;k++)others.push(node - 2*k*step);
others.sort((a,b)=>Math.abs(a - node)- Math.abs(b - node)||a - b);
weights.set(lagrange(beside,node),node*width);
const all=beside.concat(others).slice(0,width);
counts[node]=all.length;
neighbours.set(all,node*width);
order[done++]=node;
}
}
const before=Int32Array.from({length:last},(_,frame)=>frame),after=before.map((frame)=>frame + 1);
return inOrder(order,neighbours,counts,weights,width,adjacency(before,after,last,count),true);
}
function lagrange(nodes,at){
return nodes.map((node)=>{
let over=1,under=1;
for(const other of nodes){
if(other===node)continue;
over*=at - other;
under*=node - other;
}
return over / under;
});
}
function inOrder(order,neighbours,counts,weights,width,{starts,beside},overTime){
const size=order.length,place=new Int32Array(size);
for(let node=0;node<size;node++)place[order[node]]=node;
const graph={
order,place,width,overTime,
neighbours:new Int32Array(size*width),counts:new Int32Array(size),weights:new Float64Array(size*width),
ring:new Int32Array(beside.length),ringStarts:new Int32Array(size + 1),
};
for(let node=0,next=0;node<size;node++){
const own=order[node];
graph.counts[node]=counts[own];
for(let i=0;i<counts[own];i++){
graph.neighbours[node*width + i]=place[neighbours[own*width + i]];
graph.weights[node*width + i]=weights[own*width + i];
}
for(let at=starts[own];at<starts[own + 1];at++)graph.ring[next++]=place[beside[at]];
graph.ringStarts[node + 1]=next;
}
return graph;
}
function coarserLevels({starts,beside},count,neighbours,counts){
const levels=[];
while(beside.length){
const nodes=byDegree(starts,count),fewest=starts[nodes[0]+ 1]- starts[nodes[0]];
const gone=independent(nodes,starts,beside,Math.max(WIDEST,fewest));
const{ends,others}=collapse(gone,starts,beside,neighbours,counts);
const away=new Uint8Array(count);
for(const node of gone)away[node]=1;
const allEnds=new Int32Array(beside.length / 2 + ends.length),allOthers=new Int32Array(allEnds.length);
let size=ends.length;
allEnds.set(ends);
allOthers.set(others);
for(let node=0;node<count;node++){
if(away[node])continue;
for(let at=starts[node];at<starts[node + 1];at++){
if(beside[at]<node||away[beside[at]])continue;
allEnds[size]=node;
allOthers[size++]=beside[at];
}
}
const after=adjacency(allEnds,allOthers,size,count);
levels.push({gone,starts,beside,ends,others,newStarts:after.starts,newBeside:after.beside});
({starts,beside}=after);
}
return levels;
}
return{meshGraph,pathGraph};
})();
const module27=(()=>{
const{BitModels}=module18;
const{MixseqError}=module0;
const{MOST}=module23;
const BITS=7;
const VOTES=MOST + 1;
function readLabels(reader,number,{order,width,neighbours,counts}){
const models=new BitModels(2,VOTES*VOTES,2 +(1<<BITS)),bits=reader.bits();
const nodes=new Int32Array(order.length),labels=new Int32Array(order.length),votes=new Int32Array(1<<BITS);
for(let node=0;node<order.length;node++){
const first=node*width,last=first + counts[node]- 1;
for(let at=first;at<=last;at++)votes[nodes[neighbours[at]]]++;
const winner=(without)=>{
let best=-1;
for(let at=last;at>=first;at--){
const label=nodes[neighbours[at]];
if(label !==without&&(best<0||votes[label]>votes[best]))best=label;
}
return best;
};
const one=winner(-1),other=winner(one),most=one<0?0:votes[one];
models.contexts[0]=most*VOTES +(other<0?0:votes[other]);
models.contexts[1]=most*VOTES + counts[node];
for(let at=first;at<=last;at++)votes[nodes[neighbours[at]]]=0;
if(one>=0&&models.read(bits,0))nodes[node]=one;
else if(other>=0&&models.read(bits,1))nodes[node]=other;
else{
models.contexts.fill(0);
let found=1;
for(let bit=0;bit<BITS;bit++)found=2*found + models.read(bits,1 + found);
nodes[node]=found -(1<<BITS);
}
}
reader.checked(nodes);
const used=new Set(nodes);
if(used.size !==number||Math.max(...used)>=number)throw new MixseqError("labels are not those of the parts; it is damaged");
for(let node=0;node<order.length;node++)labels[order[node]]=nodes[node];
return labels;
}
return{readLabels};
})();
const module28=(()=>{
const{MOST,find}=module23;
const WIDEST=16;
const HUB=32;
function stencils({graph,levels}){
const size=graph.order.length,width=WIDEST;
const found={width,neighbours:new Int32Array(size*width),counts:graph.counts.slice(),weights:new Float64Array(size*width)};
for(let node=0;node<size;node++){
for(let i=0;i<graph.counts[node];i++){
found.neighbours[node*width + i]=graph.neighbours[node*graph.width + i];
found.weights[node*width + i]=graph.weights[node*graph.width + i];
}
}
let lengths=levels.length?new Float64Array(levels[0].beside.length).fill(1):null;
for(const level of levels){
const after=lengthsAfter(level,lengths);
bend(level,lengths,after,graph.place,found);
lengths=after;
}
return found;
}
function bend({gone,starts,beside,newStarts,newBeside},lengths,newLengths,place,found){
const slot=new Int32Array(place.length).fill(-1);
const listed=new Int32Array(MOST*(HUB + 1)),shares=new Float64Array(MOST*(HUB + 1));
for(const vertex of gone){
const first=starts[vertex],degree=Math.min(starts[vertex + 1]- first,MOST);
let slope=0;
for(let at=first;at<first + degree;at++)slope+=1 / lengths[at];
slope /=degree;
for(let i=0;i<degree;i++){
listed[i]=beside[first + i];
shares[i]=slope /(degree*lengths[first + i]);
slot[listed[i]]=i;
}
let size=degree,total=slope*slope;
for(let i=0;i<degree;i++){
const around=beside[first + i],side=lengths[first + i],low=newStarts[around],high=newStarts[around + 1];
if(high - low>HUB)continue;
const across=(at)=>{
const where=slot[newBeside[at]];
return where>=0&&where<degree&&newLengths[at]>=side + lengths[first + where];
};
let number=1;
for(let at=low;at<high;at++)if(!across(at))number++;
const own=1 /(number*side);
for(let at=low;at<high;at++){
if(across(at))continue;
const other=newBeside[at];
if(slot[other]<0){
slot[other]=size;
listed[size]=other;
shares[size++]=0;
}
const one=own /(number*newLengths[at]);
shares[i]+=one;
shares[slot[other]]-=one;
}
total+=own*own;
shares[i]+=own*own;
}
for(let i=0;i<size;i++)slot[listed[i]]=-1;
write(place[vertex],degree,size,total,listed,shares,place,found);
}
}
function write(node,degree,size,total,listed,shares,place,{width,neighbours,counts,weights}){
const kept=Math.min(size,width);
let left=1;
for(let i=0;i<kept;i++){
let best=i;
for(let j=i + 1;i>=degree&&j<size;j++)if(Math.abs(shares[j])>Math.abs(shares[best]))best=j;
const vertex=listed[i],share=shares[i];
listed[i]=listed[best];
shares[i]=shares[best];
listed[best]=vertex;
shares[best]=share;
left-=shares[i]/ total;
}
counts[node]=kept;
for(let i=0;i<kept;i++){
neighbours[node*width + i]=place[listed[i]];
weights[node*width + i]=shares[i]/ total + left / kept;
}
}
function lengthsAfter({gone,starts,beside,ends,newStarts,newBeside},lengths){
const found=new Float64Array(newBeside.length).fill(Infinity);
for(let vertex=0;vertex<starts.length - 1;vertex++){
let at=starts[vertex];
const end=starts[vertex + 1];
for(let where=newStarts[vertex];where<newStarts[vertex + 1];where++){
while(at<end&&beside[at]<newBeside[where])at++;
if(at<end&&beside[at]===newBeside[where])found[where]=lengths[at];
}
}
const shorten=(one,other,length)=>{
const where=find(newBeside,newStarts[one],newStarts[one + 1],other);
found[where]=Math.min(found[where],length);
};
let count=0;
for(const vertex of gone){
const first=starts[vertex],last=starts[vertex + 1];
if(last - first<2)continue;
const best=ends[count],side=lengths[find(beside,first,last,best)];
for(let at=first;at<last;at++){
if(beside[at]===best)continue;
shorten(best,beside[at],side + lengths[at]);
shorten(beside[at],best,side + lengths[at]);
count++;
}
}
return found;
}
return{stencils};
})();
const module29=(()=>{
const{MixseqError}=module0;
const{readLabels}=module27;
const{UNIT}=module19;
const{Reader,SignalCoder,numberModels}=module22;
const{meshGraph,pathGraph}=module26;
const{stencils}=module28;
const GROUP=12;
const LARGEST=2**127;
function groupsOfParts(ranks){
const groups=[];
ranks.forEach((rank,part)=>{
for(let left=rank,size=GROUP,group=0;left;size*=2,group++){
const count=Math.min(size,left);
left-=count;
(groups[group]??=[]).push({part,count,left});
}
});
return groups;
}
function readBasis(streams,{factors,ranks,step},triangles,mesh){
const shapes=factors==="shapes",models=numberModels(),groups=groupsOfParts(ranks);
if(streams.length !==groups.length)throw new MixseqError("there are not as many groups of basis vectors as it says; it is damaged");
const readers=streams.map((stream)=>new Reader(stream));
const labels=ranks.length>1&&readLabels(readers[0],ranks.length,mesh.graph);
const places=labels?partsOf(labels,ranks.length,triangles):[wholeOf(mesh)],coders=[];
const coderOf=(part)=>{
const own=places[part].mesh();
return new SignalCoder(own.graph,stencils(own),shapes?3:1,models);
};
const basis={shapes,parts:places.map(({vertices})=>({vertices,numbers:[],fields:[]})),owners:[],norms:[]};
if(!shapes)basis.parts.forEach(({vertices},part)=>add(basis,part,[constant(vertices.length)],1));
groups.forEach((group,number)=>{
for(const{part,count,left}of group){
const coder=(coders[part]??=coderOf(part));
for(let k=0;k<count;k++)addVector(basis,part,coder,readers[number],step / UNIT);
if(!left)coders[part]=null;
}
readers[number].finish();
});
const{parts,owners,norms}=basis,count=(shapes?3:1)*owners.length;
return{shapes,owners,norms,fields:{count,parts:parts.map(byVertex)}};
}
const constant=(size)=>new Float32Array(size).fill(1 / Math.sqrt(size));
function addVector(basis,part,coder,reader,unit){
let squares=0;
const{shapes,owners}=basis,fields=Array.from({length:shapes?3:1},()=>{
const values=coder.read(reader),field=new Float32Array(values.length);
for(let i=0;i<values.length;i++){
squares+=values[i]*values[i];
field[i]=values[i]*unit;
}
return field;
});
const norm=Math.sqrt(squares)*unit;
if(!(norm<LARGEST))throw new MixseqError("basis vectors are beyond single precision");
if(squares||(shapes&&!owners.length))add(basis,part,fields,norm);
}
function add({parts,owners,norms},part,fields,norm){
const first=fields.length*owners.length;
fields.forEach((field,axis)=>{
parts[part].fields.push(field);
parts[part].numbers.push(first + axis);
});
owners.push(part);
norms.push(norm);
}
function byVertex({vertices,numbers,fields}){
const values=new Float32Array(fields.length*vertices.length);
fields.forEach((field,k)=>{
for(let vertex=0,at=k;vertex<field.length;vertex++,at+=fields.length)values[at]=field[vertex];
});
return{vertices,fields:Uint32Array.from(numbers),values};
}
const wholeOf=(mesh)=>({vertices:Uint32Array.from(mesh.graph.order.keys()),mesh:()=>mesh});
function partsOf(labels,number,triangles){
const own=new Int32Array(labels.length),vertices=Array.from({length:number},()=>[]);
const inside=Array.from({length:number},()=>[]);
for(let vertex=0;vertex<labels.length;vertex++)own[vertex]=vertices[labels[vertex]].push(vertex)- 1;
for(let k=0;k<triangles.length;k+=3){
const a=triangles[k],b=triangles[k + 1],c=triangles[k + 2],part=labels[a];
if(labels[b]===part&&labels[c]===part)inside[part].push(own[a],own[b],own[c]);
}
return vertices.map((some,part)=>{
return{vertices:Uint32Array.from(some),mesh:()=>meshGraph(Uint32Array.from(inside[part]),some.length)};
});
}
function readWeights(stream,basis,count,step,frames){
const{shapes,owners,norms,fields}=basis,width=3*fields.count,graph=pathGraph(count);
const weights=new Float64Array(count*width),models=numberModels(),reader=new Reader(stream);
const coders=fields.parts.map(()=>new SignalCoder(graph,graph,shapes?1:3,models));
owners.forEach((part,vector)=>{
if(shapes&&!vector)return spread(weights,width,0,new Float64Array(count).fill(1 / Math.sqrt(frames)));
for(let axis=0;axis<(shapes?1:3);axis++){
const values=coders[part].read(reader),unit=step / UNIT / norms[vector];
for(let frame=0;frame<count;frame++)values[frame]*=unit;
if(shapes)spread(weights,width,9*vector,values);
else for(let frame=0;frame<count;frame++)weights[frame*width + 3*vector + axis]=values[frame];
}
});
reader.finish();
if(!weights.every(Number.isFinite))throw new MixseqError("coded signals are not finite; it is damaged");
return weights;
}
function spread(weights,width,first,values){
values.forEach((value,frame)=>{
for(let axis=0;axis<3;axis++)weights[frame*width + first + 4*axis]=value;
});
}
return{readBasis,readWeights};
})();
const module30=(()=>{
const{crc32}=module12;
const{MixseqError}=module0;
const MAGIC=0x3471736d;
const HEAD=16;
function readIndex(text,bytes,hasUvs){
const damaged=new MixseqError("the index is damaged, so nothing can be read");
if(bytes.length<HEAD)throw damaged;
const view=new DataView(bytes.buffer,bytes.byteOffset,bytes.length),word=(at)=>view.getUint32(at,true);
const middle=HEAD + word(4),end=middle + word(8);
if(word(0)!==MAGIC||end>bytes.length||word(8)% 4||crc32(bytes.subarray(HEAD,end))!==word(12))throw damaged;
if(end===middle||crc32(new TextEncoder().encode(text))!==word(middle))throw damaged;
const numbers=leb128(bytes.subarray(HEAD,middle)),[groups,chunks]=numbers;
const counts=numbers.slice(2,2 + chunks),lengths=numbers.slice(2 + chunks);
const checks=(end - middle)/ 4 - 1,full=lengths.filter((length)=>length>0).length;
if(lengths.length !==3 + hasUvs + groups + 2*chunks||counts.includes(0)||checks !==full)throw damaged;
let start=end,checksum=middle,next=0;
const stream=(what)=>{
const length=lengths[next++],data=bytes.subarray(start,(start+=length));
if(length&&!(data.length===length&&crc32(data)===word((checksum+=4))))throw new MixseqError(`${what} are damaged`);
return data;
};
const connectivity=stream("the connectivity's bytes"),surface=stream("the surface's bytes");
const times=stream("the times"),uvs=hasUvs?stream("the texture coordinates"):null,basis=[];
for(let group=0;group<groups;group++)basis.push(stream(`the basis vectors of group ${group}`));
let first=0;
return{
connectivity,surface,times,uvs,basis,
chunks:counts.map((count)=>{
const frames=`of frames ${first} to ${first + count - 1}`;
const coefficients=stream(`the coefficients ${frames}`),residuals=stream(`the residuals ${frames}`);
first+=count;
return{first:first - count,count,coefficients,residuals};
}),
};
}
function leb128(bytes){
const numbers=[];
let number=0,unit=1;
for(const byte of bytes){
number+=(byte&127)*unit;
unit*=128;
if(byte&128)continue;
numbers.push(number);
number=0;
unit=1;
}
return numbers;
}
return{readIndex};
})();
const module31=(()=>{
const{MixseqError}=module0;
const ORDER=[16,17,18,0,8,7,9,6,10,5,11,4,12,3,13,2,14,1,15];
function inflated(data,size){
const found=new Uint8Array(size);
let place=2,bit=0,count=0,last=0;
const damaged=()=>new MixseqError("compressed bytes are damaged");
const bits=(number)=>{
let value=0;
for(let k=0;k<number;k++){
if(place>=data.length)throw damaged();
value|=((data[place]>>bit)&1)<<k;
bit=(bit + 1)&7;
if(!bit)place++;
}
return value;
};
const put=(byte)=>{
if(count===size)throw damaged();
found[count++]=byte;
};
const symbol=({counts,symbols})=>{
for(let length=1,code=0,first=0,index=0;length<16;length++){
code|=bits(1);
if(code - first<counts[length])return symbols[index + code - first];
index+=counts[length];
first=(first + counts[length])<<1;
code<<=1;
}
throw damaged();
};
const extended=(base,number,per)=>{
const extra=number<per?0:Math.floor(number / per)- 1;
return base +(extra?((per +(number % per))<<extra):number)+ bits(extra);
};
while(!last){
last=bits(1);
const kind=bits(2);
if(kind===0){
if(bit)place+=1;
bit=0;
const length=data[place]|(data[place + 1]<<8);
place+=4;
if(!(place + length<=data.length))throw damaged();
for(let k=0;k<length;k++)put(data[place++]);
continue;
}
if(kind===3)throw damaged();
const{literals,distances}=kind===1?FIXED:codes(bits,symbol,damaged);
for(let one=symbol(literals);one !==256;one=symbol(literals)){
if(one<256){
put(one);
continue;
}
if(one>285)throw damaged();
const length=one===285?258:extended(3,one - 257,4),far=symbol(distances);
const distance=extended(1,far,2);
if(far>29||distance>count)throw damaged();
for(let k=0;k<length;k++)put(found[count - distance]);
}
}
const end=new DataView(data.buffer,data.byteOffset,data.length),checked=place +(bit?1:0);
if(count !==size||checked + 4>data.length||end.getUint32(checked)!==adler32(found))throw damaged();
return found;
}
function adler32(bytes){
let low=1,high=0;
for(const byte of bytes){
low=(low + byte)% 65521;
high=(high + low)% 65521;
}
return high*65536 + low;
}
const FIXED={
literals:code(Array.from({length:288},(_,k)=>(k<144?8:k<256?9:k<280?7:8))),
distances:code(new Array(30).fill(5)),
};
function code(lengths){
const counts=new Array(16).fill(0),symbols=[];
for(let length=1;length<16;length++){
lengths.forEach((own,one)=>{
if(own !==length)return;
counts[length]++;
symbols.push(one);
});
}
return{counts,symbols};
}
function codes(bits,symbol,damaged){
const literals=bits(5)+ 257,all=literals + bits(5)+ 1,number=bits(4)+ 4,short=new Array(19).fill(0);
for(let k=0;k<number;k++)short[ORDER[k]]=bits(3);
const of=code(short),lengths=[];
while(lengths.length<all){
const one=symbol(of);
if(one<16)lengths.push(one);
else{
if(one===16&&!lengths.length)throw damaged();
const again=one===16?lengths[lengths.length - 1]:0,times=one===18?bits(7)+ 11:bits(one - 14)+ 3;
for(let k=0;k<times;k++)lengths.push(again);
}
}
if(lengths.length>all)throw damaged();
return{literals:code(lengths.slice(0,literals)),distances:code(lengths.slice(literals))};
}
return{inflated};
})();
const module32=(()=>{
const{MixseqError}=module0;
const{inflated}=module31;
function unpackTimes(packed,first,count,fps){
const times=Float64Array.from({length:count},(_,frame)=>first + frame / fps);
if(packed.length)addDifferences(times,inflated(packed,8*count));
if(!times.every((time,k)=>Number.isFinite(time)&&!(k&&time<=times[k - 1]))){
throw new MixseqError("the times of frames do not increase; it is damaged");
}
return times;
}
function addDifferences(times,bytes){
const count=times.length,view=new DataView(new ArrayBuffer(8)),wrapped=2**32;
const half=(k,byte)=>{
const of=(which)=>bytes[(byte + which)*count + k]<<(8*which);
return(of(0)|of(1)|of(2)|of(3))>>>0;
};
for(let k=0,low=0,high=0;k<count;k++){
low+=half(k,0);
high=(high + half(k,4)+ Math.floor(low / wrapped))% wrapped;
low %=wrapped;
view.setFloat64(0,times[k],true);
const sum=view.getUint32(0,true)+ low;
view.setUint32(0,sum,true);
view.setUint32(4,view.getUint32(4,true)+ high + Math.floor(sum / wrapped),true);
times[k]=view.getFloat64(0,true);
}
}
return{unpackTimes};
})();
const module33=(()=>{
const{decodePolygons}=module7;
const{Curve}=module11;
const{checkOf,refuseOthers,withoutCheck}=module13;
const{MixseqError,guarded}=module0;
const{readFacts}=module14;
const{triangulated}=module15;
const{evaluate}=module16;
const{ResidualLayer}=module25;
const{meshGraph}=module26;
const{readBasis,readWeights}=module29;
const{readIndex}=module30;
const{unpackTimes}=module32;
function open(text,streams){
return guarded("the sequence",()=>new Sequence(text,streams));
}
class Sequence{
#between;
#polygons;
#triangles;
#basis;
#weights=[];
constructor(text,bytes){
const{firstTime,between,...told}=readFacts(text);
Object.assign(this,told,{streams:readIndex(text,bytes,told.parameters.uvSteps !==null)});
this.chunks=this.streams.chunks.map(({first,count})=>({first,count,loaded:false}));
if(this.chunks.reduce((sum,{count})=>sum + count,0)!==this.frameCount){
throw new MixseqError(`its chunks are not of ${this.frameCount} frames; it is damaged`);
}
this.times=unpackTimes(this.streams.times,firstTime,this.frameCount,this.fps);
this.#between=between;
}
polygons(){
return(this.#polygons??=guarded("the connectivity",()=>{
const{data,expected}=withoutCheck(this.streams.connectivity);
const found=decodePolygons(data,this.polygonCount,this.cornerCount,this.vertexCount);
refuseOthers(checkOf(found.corners,checkOf(found.counts)),expected);
return found;
}));
}
triangles(){
const{counts,corners}=this.polygons();
return(this.#triangles??=guarded("the polygons",()=>triangulated(counts,corners)));
}
fields(){
return this.#decoded().basis.fields;
}
load(number){
const chunk=this.chunks[number];
if(!chunk||chunk.loaded)return;
const{basis}=this.#decoded(),{first,count}=chunk,{coefficients}=this.streams.chunks[number];
this.#weights[number]=guarded(`the coefficients of frames ${first} to ${first + count - 1}`,()=>
readWeights(coefficients,basis,count,this.parameters.step,this.frameCount));
chunk.loaded=true;
}
weights(time,out=new Float32Array(this.#decoded().width)){
out.set(this.#at(time));
return out;
}
at(time,out=new Float32Array(3*this.vertexCount)){
evaluate(this.fields(),this.#at(time),out);
this.#residuals()?.addTo(out,this.#inside(time));
return out;
}
frame(number,out){
return this.at(this.times[Math.min(Math.max(Math.round(number),0),this.frameCount - 1)],out);
}
residuals(time){
const out=this.#residuals()&&new Float32Array(3*this.vertexCount);
return out&&this.#residuals().addTo(out,this.#inside(time))?out:null;
}
#inside(time){
if(Number.isNaN(Number(time)))throw new MixseqError("a time is no number");
return Math.min(Math.max(time,this.times[0]),this.times[this.frameCount - 1]);
}
#at(time){
return this.#decoded().curve.at(this.#inside(time));
}
#residuals(){
return this.#decoded().residuals;
}
#decoded(){
const triangles=this.triangles();
return(this.#basis??=guarded("the basis vectors",()=>{
const mesh=meshGraph(triangles,this.vertexCount),{chunks,basis:groups}=this.streams;
const basis=readBasis(groups,this.parameters,triangles,mesh),width=3*basis.fields.count;
const displaced=chunks.some(({residuals})=>residuals.length);
return{
basis,width,
curve:new Curve(this.times,this.#between,width,(frame)=>this.#row(frame)),
residuals:displaced?new ResidualLayer(this.times,chunks,mesh.graph,this.parameters.correction):null,
};
}));
}
#row(frame){
const number=this.chunks.findIndex(({first,count})=>frame<first + count);
this.load(number);
const{width}=this.#decoded(),start=(frame - this.chunks[number].first)*width;
return this.#weights[number].subarray(start,start + width);
}
}
return{open,Sequence, MixseqError };
})();
const module34=(()=>{
const BUCKETS=4;
function cornersOf(counts,node,nodeCount){
const size=node.length,starts=new Int32Array(counts.length + 1),polygon=new Int32Array(size);
const all=Int32Array.from(node,(_,corner)=>corner),after=all.map((corner)=>corner + 1),before=all.map((corner)=>corner - 1);
counts.forEach((count,p)=>{
const start=starts[p],stop=(starts[p + 1]=start + count);
polygon.fill(p,start,stop);
after[stop - 1]=start;
before[start]=stop - 1;
});
const{order:around,starts:aroundStarts}=sorted(all,node,nodeCount);
return{starts,polygon,node,after,before,twin:twins(node,after,around,nodeCount),aroundStarts,around};
}
function sorted(corners,keys,size){
const starts=new Int32Array(size + 1),order=new Int32Array(corners.length);
for(const key of keys)starts[key + 1]++;
for(let key=0;key<size;key++)starts[key + 1]+=starts[key];
const filled=starts.slice();
for(const corner of corners)order[filled[keys[corner]]++]=corner;
return{order,starts};
}
function twins(tails,after,around,nodeCount){
const heads=tails.map((_,corner)=>tails[after[corner]]),twin=new Int32Array(tails.length).fill(-1);
const back=sorted(around,heads,nodeCount).order,forth=sorted(sorted(twin.map((_,corner)=>corner),heads,nodeCount).order,tails,nodeCount).order;
for(let i=0,j=0;i<forth.length&&j<back.length;){
const there=forth[i],wanted=back[j],apart=tails[there]- heads[wanted]||heads[there]- tails[wanted];
if(apart<=0)i++;
if(apart>=0)j++;
if(apart===0&&tails[there]!==heads[there])twin[wanted]=there;
}
return twin;
}
function growingOrder({starts,polygon,node,aroundStarts,around}){
const count=starts.length - 1,unknown=new Int32Array(count),visited=new Uint8Array(count),order=new Int32Array(count);
const known=new Uint8Array(aroundStarts.length - 1),queued=new Int32Array(node.length),following=new Int32Array(node.length).fill(-1);
const heads=new Int32Array(BUCKETS).fill(-1),tails=new Int32Array(BUCKETS);
let lowest=0,entries=0;
for(let p=0;p<count;p++)unknown[p]=starts[p + 1]- starts[p];
function next(){
for(let bucket=0;bucket<BUCKETS;bucket++){
while(heads[bucket]>=0){
const p=queued[heads[bucket]];
heads[bucket]=following[heads[bucket]];
if(!visited[p]&&Math.min(unknown[p],BUCKETS - 1)===bucket)return p;
}
}
while(visited[lowest])lowest++;
return lowest;
}
function enqueue(p){
const bucket=Math.min(unknown[p],BUCKETS - 1);
queued[entries]=p;
if(heads[bucket]<0)heads[bucket]=entries;
else following[tails[bucket]]=entries;
tails[bucket]=entries++;
}
for(let place=0;place<count;place++){
const chosen=(order[place]=next());
visited[chosen]=1;
for(let corner=starts[chosen];corner<starts[chosen + 1];corner++){
const at=node[corner];
if(known[at])continue;
known[at]=1;
for(let k=aroundStarts[at];k<aroundStarts[at + 1];k++){
const p=polygon[around[k]];
if(visited[p])continue;
unknown[p]--;
enqueue(p);
}
}
}
return order;
}
return{cornersOf,growingOrder};
})();
const module35=(()=>{
const SEAM_KINDS=4;
const MOST_NODES=32;
const INTO=0,OUT=1,OTHER=2,BOTH=3;
function walkSeams(bits,corners,order){
const{starts,node:vertex,twin,before,after,aroundStarts}=corners,nodes=new Int32Array(vertex.length).fill(-1);
const newest=new Int32Array(aroundStarts.length - 1).fill(-1),older=new Int32Array(vertex.length);
const several=new Int32Array(newest.length),done=new Int32Array(newest.length);
let count=0,history=0;
for(const polygon of order){
for(let corner=starts[polygon];corner<starts[polygon + 1];corner++){
const at=vertex[corner],last=before[corner],following=after[corner];
let into=-1,out=-1,alongInto=2,alongOut=2,chosen=-1;
if(twin[last]>=0){
into=nodes[twin[last]];
alongInto=along(nodes[last],nodes[after[twin[last]]]);
}
if(twin[corner]>=0){
out=nodes[after[twin[corner]]];
alongOut=along(nodes[following],nodes[twin[corner]]);
}
const left=aroundStarts[at + 1]- aroundStarts[at]- done[at],own=Math.min(several[at],3)*8 + Math.min(left,7);
const edges=(alongOut*3 + alongInto)*4 +(out>=0?1:0)+(into>=0?2:0);
const around=(own*4 + Math.min(several[vertex[last]],3))*4 + Math.min(several[vertex[following]],3);
const ask=(kind)=>{
const share=Math.min(several[at],7);
bits.contexts.set([edges,(around<<8)|edges,((history&15)<<8)|edges,(share<<8)|edges,(own<<8)|edges,around,history,((around>>4)<<12)|(edges<<4)|(history&15)]);
for(let i=0;i<8;i++)bits.contexts[i]=(bits.contexts[i]<<4)|kind;
const bit=bits.next(kind);
if(kind !==OTHER)history=((history<<1)|bit)&255;
return bit;
};
if(into>=0&&ask(into===out?BOTH:INTO))chosen=into;
if(chosen<0&&out>=0&&out !==into&&ask(OUT))chosen=out;
for(let node=newest[at],looked=0;chosen<0&&node>=0&&looked<MOST_NODES;node=older[node],looked++){
if(node !==into&&node !==out&&ask(OTHER))chosen=node;
}
if(chosen<0){
chosen=count++;
older[chosen]=newest[at];
newest[at]=chosen;
several[at]++;
}
nodes[corner]=chosen;
done[at]++;
}
}
return{nodes,count};
}
const along=(one,other)=>(one<0||other<0?2:one===other?1:0);
return{SEAM_KINDS,MOST_NODES,walkSeams};
})();
const module36=(()=>{
const{mixedBits}=module2;
const{unpackQueues}=module4;
const{MixseqError}=module0;
const{cornersOf,growingOrder}=module34;
const{MOST_NODES,SEAM_KINDS,walkSeams}=module35;
const FIRST_WEIGHT=11000;
function decodeHardEdges(bytes,counts,corners,vertexCount){
const most=corners.length*(2 + MOST_NODES),mesh=cornersOf(counts,corners,vertexCount);
const bits=mixedBits(unpackQueues(bytes,0,most,"hard edges"),SEAM_KINDS,FIRST_WEIGHT);
const{nodes,count}=walkSeams(bits,mesh,growingOrder(mesh));
if(!bits.ended())throw new MixseqError("hard edges are damaged, or those of another mesh");
const numbers=new Int32Array(count).fill(-1);
let used=0;
return nodes.map((node)=>(numbers[node]<0?(numbers[node]=used++):numbers[node]));
}
return{decodeHardEdges};
})();
const module37=(()=>{
const{MixseqError}=module0;
const POSITIONS=16,STATES=12,FIRST_LITERALS=7;
const damaged=()=>new MixseqError("compressed bytes are damaged");
function unpackLzma2(data,limit){
const chunks=chunksOf(data),size=chunks.reduce((sum,chunk)=>sum + chunk.size,0);
if(size>limit)throw new MixseqError(`${size} bytes are more than there can be; the file is damaged`);
const out=new Uint8Array(size);
let at=0,coder=null,properties=255,begin=0;
for(const{control,start,size,packed}of chunks){
if(control===1||control>=0xe0)begin=at;
if(control<0x80)out.set(data.subarray(start,start + size),at);
else{
const reset=(control>>5)&3;
if(reset>1)properties=data[start - 1];
if(properties>224||properties % 9 +(Math.floor(properties / 9)% 5)>4||(!reset&&!coder))throw damaged();
if(reset)coder=newCoder(out,properties);
coder(data.subarray(start,start + packed),begin,at,at + size);
}
at+=size;
}
return out;
}
function chunksOf(data){
const chunks=[];
for(let place=0;;){
const control=data[place],packs=control>=0x80,size=((packs?control&31:0)<<16)+(data[place + 1]<<8)+ data[place + 2]+ 1;
if(control===0)return chunks;
const start=place +(packs?5 +(control>=0xc0?1:0):3),packed=packs?(data[place + 3]<<8)+ data[place + 4]+ 1:size;
place=start + packed;
if(!(place<data.length)||(!packs&&control>2))throw damaged();
chunks.push({control,start,size,packed});
}
}
function newCoder(out,properties){
const lc=properties % 9,lp=Math.floor(properties / 9)% 5,pb=Math.floor(properties / 45);
const chances=(count)=>new Uint16Array(count).fill(1024),lengths=()=>({choices:chances(2),low:chances(POSITIONS*8),middle:chances(POSITIONS*8),high:chances(256)});
const isMatch=chances(STATES*POSITIONS),isRepeat=chances(STATES),isShort=chances(STATES*POSITIONS),repeats=[chances(STATES),chances(STATES),chances(STATES)];
const literals=chances(0x300<<(lc + lp)),slots=chances(4*64),far=chances(128),aligned=chances(16),matched=lengths(),repeated=lengths();
let state=0,distances=[0,0,0,0],input,place,range,code;
function normalise(){
if(range>=2**24)return;
if(place>=input.length)throw damaged();
range=(range<<8)>>>0;
code=((code<<8)|input[place++])>>>0;
}
function bit(table,index){
normalise();
const chance=table[index],bound=(range>>>11)*chance;
if(code<bound){
range=bound;
table[index]+=(2048 - chance)>>5;
return 0;
}
range-=bound;
code-=bound;
table[index]-=chance>>5;
return 1;
}
function tree(table,first,bits){
let node=1;
for(let k=0;k<bits;k++)node=2*node + bit(table,first + node);
return node -(1<<bits);
}
function reversed(table,first,bits){
let node=1,value=0;
for(let k=0;k<bits;k++){
const one=bit(table,first + node);
node=2*node + one;
value|=one<<k;
}
return value;
}
function plain(bits){
let value=0;
for(let k=0;k<bits;k++){
normalise();
range>>>=1;
const one=code>=range?1:0;
code-=one*range;
value=2*value + one;
}
return value;
}
function length({choices,low,middle,high},position){
if(!bit(choices,0))return 2 + tree(low,8*position,3);
return bit(choices,1)?18 + tree(high,0,8):10 + tree(middle,8*position,3);
}
function distance(count){
const slot=tree(slots,64*Math.min(count - 2,3),6),bits=(slot>>1)- 1;
if(slot<4)return slot;
const first=(2 +(slot&1))*2**bits;
return first +(slot<14?reversed(far,first - slot,bits):plain(bits - 4)*16 + reversed(aligned,0,4));
}
function literal(at,begin){
const before=at>begin?out[at - 1]:0,first=0x300*((((at - begin)&((1<<lp)- 1))<<lc)+(before>>(8 - lc)));
let node=1;
if(state>=FIRST_LITERALS){
let same=out[at - distances[0]- 1];
for(let offset=0x100;node<0x100;){
same<<=1;
const expected=same&offset,one=bit(literals,first + offset + expected + node);
node=2*node + one;
offset=one?expected:offset - expected;
}
}
while(node<0x100)node=2*node + bit(literals,first + node);
out[at]=node;
state=state<4?0:state<10?state - 3:state - 6;
}
return function decode(given,begin,at,end){
[input,place,range,code]=[given,5,2**32 - 1,((given[1]<<24)|(given[2]<<16)|(given[3]<<8)|given[4])>>>0];
if(given.length<5)throw damaged();
while(at<end){
const position=(at - begin)&((1<<pb)- 1),here=state*POSITIONS + position,literalState=state<FIRST_LITERALS;
if(!bit(isMatch,here)){
literal(at++,begin);
continue;
}
let count,again=0;
if(!bit(isRepeat,state)){
count=length(matched,position);
distances=[distance(count),...distances.slice(0,3)];
state=literalState?7:10;
}else{
while(again<3&&bit(repeats[again],state))again++;
if(!again&&!bit(isShort,here)){
count=1;
state=literalState?9:11;
}else{
distances.unshift(...distances.splice(again,1));
count=length(repeated,position);
state=literalState?8:11;
}
}
if(distances[0]>=at - begin||at + count>end)throw damaged();
for(const stop=at + count;at<stop;at++)out[at]=out[at - distances[0]- 1];
}
};
}
return{unpackLzma2};
})();
const module38=(()=>{
const PRECISION=1<<17,PIECE=1<<14;
function noCopies({node},order){
const places=new Int32Array(order.length);
order.forEach((polygon,place)=>(places[polygon]=place));
return{
places,image:new Int32Array(node.length).fill(-1),mirrored:new Uint8Array(order.length),
region:new Int32Array(order.length).fill(-1),anchors:new Int32Array(2*order.length).fill(-1),
};
}
function imageOf({twin,polygon,after},{region,mirrored,image},corner){
const there=twin[corner];
if(there<0||region[polygon[there]]<0)return -1;
if(!mirrored[polygon[there]])return twin[image[there]];
const edge=twin[image[after[there]]];
return edge>=0?after[edge]:-1;
}
function follow(corners,copies,p){
const{starts,polygon,twin}=corners;
for(let corner=starts[p];corner<starts[p + 1];corner++){
const image=imageOf(corners,copies,corner);
if(image>=0&&fits(corners,copies,p,polygon[image])){
const beside=polygon[twin[corner]];
giveImage(corners,copies,corner,image,copies.mirrored[beside],copies.region[beside]);
return true;
}
}
return false;
}
function fits({starts},{places},p,image){
return starts[image + 1]- starts[image]===starts[p + 1]- starts[p]&&places[image]<places[p];
}
function giveImage({polygon,starts,after,before},copies,corner,image,mirrored,region){
const p=polygon[corner];
copies.mirrored[p]=mirrored;
copies.region[p]=region;
for(let k=starts[p];k<starts[p + 1];k++){
copies.image[corner]=image;
corner=after[corner];
image=mirrored?before[image]:after[image];
}
}
function dropAnchor({node,polygon},{image,region,anchors},{values,there},corner){
const place=2*region[polygon[corner]];
if(!(there[node[corner]]&&there[node[image[corner]]]))return;
if(anchors[place]<0){
anchors[place]=corner;
return;
}
const first=node[image[anchors[place]]];
const far=(at)=>Math.abs(values[2*at]- values[2*first])+ Math.abs(values[2*at + 1]- values[2*first + 1]);
if(far(node[image[corner]])>(anchors[place + 1]<0?0:far(node[image[anchors[place + 1]]])))anchors[place + 1]=corner;
}
function copy({node,polygon,before,after},{image,region,anchors,mirrored},{values,there},corner,{at}){
const p=polygon[corner],place=2*region[p],first=anchors[place],second=anchors[place + 1];
if(place<0||!there[node[image[corner]]]||first<0)return 0;
const sound=(each)=>there[node[each]]&&there[node[image[each]]],from=[before[corner],after[corner]].find(sound)??first;
const apart=(one,other,i)=>values[2*node[one]+ i]- values[2*node[other]+ i],sign=mirrored[p]?-1:1;
const u=apart(image[corner],image[from],0),v=apart(image[corner],image[from],1),[x,y]=[0,1].map((i)=>values[2*node[from]+ i]);
if(second<0){
at[0]=x + sign*u;
at[1]=y + v;
return 1;
}
let here=[apart(second,first,0),apart(second,first,1)],far=[apart(image[second],image[first],0),sign*apart(image[second],image[first],1)];
let size=[...here,...far].reduce((sum,each)=>sum + Math.abs(each),0);
for(;size>=PRECISION;size=Math.floor(size / 2))[here,far]=[here,far].map((pair)=>pair.map((each)=>each>>1));
const whole=far[0]*far[0]+ far[1]*far[1];
if(!whole)return 0;
const turnU=here[0]*far[0]+ here[1]*far[1],turnV=here[1]*far[0]- here[0]*far[1];
at[0]=x + nearest(turnU,u,-turnV,sign*v,whole);
at[1]=y + nearest(turnU,sign*v,turnV,u,whole);
return 2;
}
function nearest(a,b,c,d,whole){
const[b1,d1]=[b,d].map((each)=>Math.floor(each / PIECE)),upper=a*b1 + c*d1,lower=a*(b - PIECE*b1)+ c*(d - PIECE*d1);
const quotient=Math.floor(upper / whole);
return PIECE*quotient + Math.floor((2*(PIECE*(upper - quotient*whole)+ lower)+ whole)/(2*whole));
}
return{noCopies,follow,fits,giveImage,dropAnchor,copy,nearest};
})();
const module39=(()=>{
const COPIED=0;
const AROUND=1;
const BEYOND=2;
const BESIDE=3;
const ANYWHERE=4;
const noGuess=()=>({at:[0,0],back:[0,0],low:[0,0],high:[0,0],kind:ANYWHERE,count:0,spread:0});
function makeGuess(corners,{values,there},corner,last,guess){
const{starts,polygon,node,twin,before,after,aroundStarts,around}=corners,x=node[corner];
const{at,back,low,high}=guess;
let count=0;
at.fill(0);
back.fill(0);
function add(u,v){
at[0]+=u;
at[1]+=v;
low[0]=count?Math.min(low[0],u):u;
low[1]=count?Math.min(low[1],v):v;
high[0]=count?Math.max(high[0],u):u;
high[1]=count?Math.max(high[1],v):v;
count++;
}
for(let place=aroundStarts[x];place<aroundStarts[x + 1];place++){
const other=around[place],a=node[before[other]],edge=after[other],b=node[edge],size=starts[polygon[other]+ 1]- starts[polygon[other]];
let across=after[edge];
if(size===3&&twin[edge]>=0)across=before[twin[edge]];
else if(size !==4)continue;
const z=node[across];
if(!(there[a]&&there[b]&&there[z])||z===x)continue;
const u=values[2*a]+ values[2*b],v=values[2*a + 1]+ values[2*b + 1],zu=values[2*z],zv=values[2*z + 1];
back[0]+=u - zu -(u>>1);
back[1]+=v - zv -(v>>1);
add(u - zu,v - zv);
}
guess.kind=AROUND;
if(count)for(let i=0;i<2;i++)back[i]=Math.floor((3*Math.floor(back[i]/ count))/ 8);
else beyond();
function beyond(){
const a=before[corner],b=after[corner];
const reach=(beside,edge,next)=>{
if(edge<0||!there[beside])return;
const e=node[next(edge)];
if(there[e])add(2*values[2*beside]- values[2*e],2*values[2*beside + 1]- values[2*e + 1]);
};
guess.kind=BEYOND;
reach(node[a],twin[before[a]],(edge)=>before[edge]);
reach(node[b],twin[b],(edge)=>after[after[edge]]);
if(count)return;
guess.kind=BESIDE;
for(const beside of[node[a],node[b]])if(there[beside])add(values[2*beside],values[2*beside + 1]);
if(count)return;
guess.kind=ANYWHERE;
add(last<0?0:values[2*last],last<0?0:values[2*last + 1]);
}
guess.count=count;
guess.spread=high[0]- low[0]+ high[1]- low[1];
for(let i=0;i<2;i++)at[i]=Math.floor((2*at[i]+ count)/(2*count));
}
return{COPIED,AROUND,BEYOND,BESIDE,ANYWHERE,noGuess,makeGuess};
})();
const module40=(()=>{
const{MixseqError}=module0;
const{copy,dropAnchor,fits,follow,giveImage,noCopies}=module38;
const{AROUND,BESIDE,COPIED,makeGuess,noGuess}=module39;
const{SEAM_KINDS}=module35;
const GROUPS=4,LARGEST=1<<26,TOLERATED=8,BACK=2*GROUPS,PLACE=2*GROUPS + 1;
const VALUE_KINDS=2*GROUPS + 2;
const LONGEST=40;
function walkValues(bits,corners,order,count){
const{starts,polygon:polygons,node,after}=corners,copies=noCopies(corners,order),guess=noGuess();
const known={values:new Int32Array(2*count),there:new Uint8Array(count),sizes:new Float64Array(count)};
const{values,there}=known,about=[0,0,0],sizes=[0,0,0,0],means=[64,64,160,160],lost=[0,0];
let last=-1;
for(const polygon of order){
const first=starts[polygon],stop=starts[polygon + 1];
let unknown=0,corner=-1,astray=false;
for(let each=first;each<stop;each++){
if(!there[node[each]])unknown++;
else if(corner<0&&!there[node[after[each]]])corner=each;
}
if(!follow(corners,copies,polygon)&&unknown){
about.fill(unknown===stop - first?1:0);
sizes.fill(0);
begin(polygon);
}
const begun=copies.region[polygon]===copies.places[polygon];
corner=Math.max(first,corner);
for(let k=first;k<stop;k++){
if(!there[node[corner]])astray=readNode(corner,node[corner])||astray;
if(begun)dropAnchor(corners,copies,known,corner);
corner=after[corner];
}
if(astray)copies.region[polygon]=-1;
else if(copies.region[polygon]>=0)for(let each=first;each<stop;each++)dropAnchor(corners,copies,known,each);
}
return values;
function readNode(corner,x){
makeGuess(corners,known,corner,last,guess);
const{at,back}=guess,seen=[...at],anchors=copy(corners,copies,known,corner,guess);
let kind=guess.kind;
if(anchors)kind=anchors===2?COPIED:BESIDE;
else if(kind===AROUND&&lost[1]<lost[0])back.forEach((each,i)=>(at[i]-=each));
const group=kind===COPIED?1:kind>=BESIDE?kind - 1:0;
expect(corner,kind,means[group]);
for(let i=0;i<2;i++){
const missed=readNumber(2*group + i),value=at[i]+ missed,length=16*bitLength(missed);
if(Math.abs(value)>LARGEST)throw damaged();
values[2*x + i]=value;
known.sizes[x]+=Math.abs(missed);
means[group]+=(length - means[group])>>4;
about[2]=sizes[3]=length;
}
const apart=(drawn)=>Math.abs(values[2*x]- seen[0]+ drawn*back[0])+ Math.abs(values[2*x + 1]- seen[1]+ drawn*back[1]);
if(guess.kind===AROUND)for(let drawn=0;drawn<2;drawn++)lost[drawn]+=sizeOf(apart(drawn))-(lost[drawn]>>5);
there[x]=1;
last=x;
return anchors===2&&known.sizes[x]>TOLERATED&&known.sizes[x]>apart(0);
}
function begin(polygon){
const place=copies.places[polygon],back=readNumber(BACK);
if(!back)return;
if(back>place)throw damaged();
const other=order[place - back],turn=readNumber(PLACE),image=starts[other]+ Math.floor(turn / 2);
if(image>=starts[other + 1]||!fits(corners,copies,polygon,other))throw damaged();
giveImage(corners,copies,starts[polygon],image,turn % 2,place);
}
function expect(corner,kind,mean){
const a=node[corners.before[corner]],b=node[after[corner]],near=(known.sizes[a]+ known.sizes[b])*(there[a]!==there[b]?2:1);
const edge=there[a]&&there[b]?Math.abs(values[2*a]- values[2*b])+ Math.abs(values[2*a + 1]- values[2*b + 1]):0;
about[0]=about[1]=(kind<<2)|Math.min(guess.count,3);
about[2]=kind;
[mean,sizeOf(near),sizeOf(edge),sizeOf(guess.spread)].forEach((size,i)=>(sizes[i]=size));
}
function readNumber(what){
const{contexts}=bits;
let length=0,value=1;
while(length<LONGEST){
const expected=beyond(length,sizes[0],4);
for(let i=0;i<4;i++)contexts[i]=beyond(length,sizes[i],3);
contexts[4]=(about[0]<<6)|length;
contexts[5]=(about[1]<<6)|expected;
contexts[6]=(((about[2]<<6)|beyond(length,sizes[2],4))<<6)|expected;
contexts[7]=(beyond(length,sizes[1],4)<<6)|expected;
for(let i=0;i<8;i++)contexts[i]=(contexts[i]<<8)|what;
if(!bits.next(SEAM_KINDS + what))break;
length++;
}
if(!length)return 0;
for(let k=1;k<length;k++)value=2*value + bits.plain();
return what<BACK&&bits.plain()?-value:value;
}
}
const damaged=()=>new MixseqError("texture coordinates are damaged");
const beyond=(length,size,shift)=>Math.min(Math.max((16*length - size + 8)>>shift,-31),31)+ 32;
function sizeOf(number){
const length=bitLength(number);
return 16*length +(Math.floor((32*number)/ 2**length)&15);
}
function bitLength(number){
const rest=Math.abs(number),high=Math.floor(rest / 2**32);
return high?64 - Math.clz32(high):32 - Math.clz32(rest);
}
return{VALUE_KINDS,LONGEST,walkValues};
})();
const module41=(()=>{
const{mixedBits}=module2;
const{unpackQueues}=module4;
const{MixseqError}=module0;
const{cornersOf,growingOrder}=module34;
const{MOST_NODES,SEAM_KINDS,walkSeams}=module35;
const{LONGEST,VALUE_KINDS,walkValues}=module40;
const FIRST_WEIGHT=11000;
function decodeUvs(bytes,counts,corners,vertexCount){
const size=corners.length,most=size*(2 + MOST_NODES)+(size + counts.length)*2*(2*LONGEST + 1);
const bits=mixedBits(unpackQueues(bytes,0,most,"texture coordinates"),SEAM_KINDS + VALUE_KINDS,FIRST_WEIGHT);
const mesh=cornersOf(counts,corners,vertexCount),{nodes,count}=walkSeams(bits,mesh,growingOrder(mesh));
const seamed=cornersOf(counts,nodes,count),values=walkValues(bits,seamed,growingOrder(seamed),count);
if(!bits.ended())throw new MixseqError("texture coordinates are damaged, or those of another mesh");
const found=new Int32Array(2*size);
nodes.forEach((node,corner)=>found.set([values[2*node],values[2*node + 1]],2*corner));
return found;
}
return{decodeUvs};
})();
const module42=(()=>{
const{checkOf,refuseOthers,withoutCheck}=module13;
const{MixseqError,guarded}=module0;
const{decodeHardEdges}=module36;
const{unpackLzma2}=module37;
const{decodeUvs}=module41;
const OF_CORNER=64,OF_TEXTS=1<<24;
const TYPES={"<i4":Int32Array,"<f4":Float32Array,"|u1":Uint8Array};
function uvsOf(sequence){
const{streams,vertexCount,parameters,cornerCount}=sequence;
return guarded("the texture coordinates",()=>{
if(!streams.uvs){
const{uv_values:values,uv_indices:rows}=surfaceOf(sequence);
if(!values)return null;
ofCorners(rows,cornerCount,values.length / 2);
return Float32Array.from({length:2*cornerCount},(_,k)=>values[2*rows[k>>1]+(k&1)]);
}
const{counts,corners}=sequence.polygons(),{data,expected}=withoutCheck(streams.uvs);
const numbers=decodeUvs(data,counts,corners,vertexCount);
refuseOthers(checkOf(numbers),expected);
return Float32Array.from(numbers,(number)=>number / parameters.uvSteps);
});
}
function hardEdgesOf(sequence){
return guarded("the hard edges",()=>{
const{hard_edges:coded,creases}=surfaceOf(sequence);
if(!coded)return creases?ofCorners(creases,sequence.cornerCount,Infinity):null;
const{counts,corners}=sequence.polygons(),{data,expected}=withoutCheck(coded);
const numbers=decodeHardEdges(data,counts,corners,sequence.vertexCount);
refuseOthers(checkOf(numbers),expected);
return numbers;
});
}
function surfaceOf({streams,cornerCount}){
if(!streams.surface.length)return{};
return guarded("the surface",()=>{
const whole=unpackLzma2(streams.surface,OF_CORNER*cornerCount + OF_TEXTS),end=whole.indexOf(0),arrays={};
let start=end + 1;
for(const[name,...what]of JSON.parse(new TextDecoder().decode(whole.subarray(0,end)))){
if(what.length===1)arrays[name]=what[0];
else{
const[type,shape]=what,count=shape.reduce((size,each)=>size*each,1);
arrays[name]=unshuffled(whole,start,TYPES[type],count);
start+=arrays[name].byteLength;
}
}
return arrays;
});
}
function ofCorners(numbers,cornerCount,size){
if(numbers.length !==cornerCount||numbers.some((number)=>number<0||number>=size))throw new MixseqError("there are numbers out of range; it is damaged");
return numbers;
}
function unshuffled(whole,start,Type,count){
const size=Type.BYTES_PER_ELEMENT;
if(!(start + size*count<=whole.length))throw new MixseqError("it ends early; it is damaged");
const bytes=new Uint8Array(size*count),numbers=new Type(bytes.buffer);
for(let k=0;k<bytes.length;k++)bytes[(k % count)*size + Math.floor(k / count)]=whole[start + k];
if(Type===Int32Array)for(let k=1;k<count;k++)numbers[k]+=numbers[k - 1];
return numbers;
}
return{uvsOf,hardEdgesOf,surfaceOf};
})();
const module43=(()=>{
const{triangulated}=module15;
const{hardEdgesOf,uvsOf}=module42;
function drawnMesh(sequence){
const{counts,corners}=sequence.polygons(),uvs=uvsOf(sequence),normals=byFirstUse(hardEdgesOf(sequence))??corners;
const first=new Int32Array(sequence.vertexCount).fill(-1),next=new Int32Array(corners.length);
const cut=[],drawn=new Uint32Array(corners.length);
const same=(a,b)=>normals[a]===normals[b]&&(!uvs||(uvs[2*a]===uvs[2*b]&&uvs[2*a + 1]===uvs[2*b + 1]));
for(let corner=0;corner<corners.length;corner++){
let found=first[corners[corner]];
while(found>=0&&!same(cut[found],corner))found=next[found];
if(found<0){
found=cut.push(corner)- 1;
next[found]=first[corners[corner]];
first[corners[corner]]=found;
}
drawn[corner]=found;
}
return{
triangles:triangulated(counts,drawn),
vertices:Uint32Array.from(cut,(corner)=>corners[corner]),
groups:Uint32Array.from(cut,(corner)=>normals[corner]),
uvs:uvs&&Float32Array.from({length:2*cut.length},(_,k)=>(k&1?1 - uvs[2*cut[k>>1]+ 1]:uvs[2*cut[k>>1]])),
};
}
function byFirstUse(numbers){
const known=new Map();
return numbers?.map((number)=>known.get(number)??known.set(number,known.size).size - 1);
}
function takePositions(positions,vertices,out){
for(let k=0;k<vertices.length;k++){
for(let axis=0;axis<3;axis++)out[3*k + axis]=positions[3*vertices[k]+ axis];
}
return out;
}
function takeNormals(positions,triangles,groups,out){
const sums=new Float32Array(3*(groups.reduce((most,group)=>Math.max(most,group),-1)+ 1));
for(let k=0;k<triangles.length;k+=3){
const a=3*triangles[k],b=3*triangles[k + 1],c=3*triangles[k + 2];
const x=positions[b]- positions[a],y=positions[b + 1]- positions[a + 1],z=positions[b + 2]- positions[a + 2];
const u=positions[c]- positions[a],v=positions[c + 1]- positions[a + 1],w=positions[c + 2]- positions[a + 2];
for(let corner=k;corner<k + 3;corner++){
const group=3*groups[triangles[corner]];
sums[group]+=y*w - z*v;
sums[group + 1]+=z*u - x*w;
sums[group + 2]+=x*v - y*u;
}
}
for(let k=0;k<groups.length;k++){
const x=sums[3*groups[k]],y=sums[3*groups[k]+ 1],z=sums[3*groups[k]+ 2],size=Math.sqrt(x*x + y*y + z*z);
out[3*k]=size>0?x / size:0;
out[3*k + 1]=size>0?y / size:0;
out[3*k + 2]=size>0?z / size:1;
}
return out;
}
return{drawnMesh,takePositions,takeNormals};
})();
const module44=(()=>{
const WIDTH=2048;
function fieldLayout({parts},vertexCount){
const rows=parts.map(({fields})=>Math.ceil(fields.length / 4)),places=new Int32Array(4*vertexCount);
const texels=new Float32Array(4*inRows(parts.reduce((sum,{vertices},p)=>sum + vertices.length*rows[p],0)));
const order=new Int32Array(4*rows.reduce((sum,count)=>sum + count,0)).fill(-1);
let first=0,row=0;
parts.forEach(({vertices,fields,values},p)=>{
const size=vertices.length,count=fields.length;
for(let i=0;i<size;i++){
places.set([first + i,size,rows[p],row],4*vertices[i]);
for(let k=0;k<count;k++)texels[4*(first +(k>>2)*size + i)+(k&3)]=values[i*count + k];
}
order.set(fields,4*row);
first+=size*rows[p];
row+=rows[p];
});
return{texels,places,order};
}
function weightRows(order,weights,out){
order.forEach((field,slot)=>{
const place=12*(slot>>2)+(slot&3);
for(let axis=0;field>=0&&axis<3;axis++)out[place + 4*axis]=weights[3*field + axis];
});
return out;
}
function ringLayout(triangles,groups){
const starts=new Int32Array(groups.reduce((most,group)=>Math.max(most,group),0)+ 2),pairs=new Int32Array(2*inRows(triangles.length));
for(const vertex of triangles)starts[groups[vertex]+ 1]++;
for(let group=1;group<starts.length;group++)starts[group]+=starts[group - 1];
const filled=starts.slice(),places=new Int32Array(2*groups.length);
triangles.forEach((vertex,corner)=>{
const first=corner -(corner % 3),beside=triangles[first +((corner + 1)% 3)],last=triangles[first +((corner + 2)% 3)];
pairs.set([beside,last],2*filled[groups[vertex]]++);
});
groups.forEach((group,vertex)=>places.set([starts[group],starts[group + 1]- starts[group]],2*vertex));
return{pairs,places};
}
const inRows=(count)=>Math.max(Math.ceil(count / WIDTH),1)*WIDTH;
return{WIDTH,fieldLayout,weightRows,ringLayout,inRows};
})();
const module45=(()=>{
const{MixseqError}=module0;
const{WIDTH,fieldLayout,inRows,ringLayout,weightRows}=module44;
const HEAD=`#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp isampler2D;
ivec2 at(int texel) { return ivec2(texel % ${WIDTH}, texel / ${WIDTH}); }
`;
const POSITIONS=`${HEAD}
in ivec4 place; // first texel, texels to the next, number of texels, first row of weights
in int vertex;
uniform sampler2D fields, weights, residuals;
uniform int displaced;
out vec4 result;
void main() {
  vec3 sum = displaced == 0 ? vec3(0.0) : texelFetch(residuals, at(vertex), 0).xyz;
  for (int k = 0; k < place.z; k++) {
    vec4 field = texelFetch(fields, at(place.x + k * place.y), 0);
    int row = place.w + k;
    sum += vec3(dot(field, texelFetch(weights, ivec2(0, row), 0)), dot(field, texelFetch(weights, ivec2(1, row), 0)), dot(field, texelFetch(weights, ivec2(2, row), 0)));
  }
  result = vec4(sum, 1.0);
}`;
const NORMALS=`${HEAD}
in ivec2 place; // first pair, number of pairs
uniform sampler2D positions;
uniform isampler2D pairs;
out vec3 result;
void main() {
  vec3 sum = vec3(0.0);
  for (int k = 0; k < place.y; k++) {
    ivec2 pair = texelFetch(pairs, at(place.x + k), 0).xy;
    vec3 here = texelFetch(positions, at(gl_VertexID), 0).xyz;
    sum += cross(texelFetch(positions, at(pair.x), 0).xyz - here, texelFetch(positions, at(pair.y), 0).xyz - here);
  }
  float size = length(sum);
  result = size > 0.0 ? sum / size : vec3(0.0, 0.0, 1.0);
}`;
const NOTHING=`#version 300 es
void main() {}`;
function fieldTextures(gl,fields,triangles,vertices=null,groups=vertices){
const known=fields.parts.reduce((sum,part)=>sum + part.vertices.length,0),{texels,places,order}=fieldLayout(fields,known);
const named=Int32Array.from(vertices??{length:known},(vertex,k)=>vertex??k),count=named.length;
const own=Int32Array.from({length:4*count},(_,k)=>places[4*named[k>>2]+(k&3)]),ring=ringLayout(triangles,groups??named);
const rows=order.length / 4,weightTexels=new Float32Array(12*rows),largest=gl.getParameter(gl.MAX_TEXTURE_SIZE),made=[];
if(Math.max(rows,texels.length /(4*WIDTH),ring.pairs.length /(2*WIDTH))>largest){
throw new MixseqError("the sequence is too large for textures of this graphics card; take its positions from Sequence.at");
}
const textures={
fields:newTexture(gl.RGBA32F,WIDTH,texels.length /(4*WIDTH)),weights:newTexture(gl.RGBA32F,3,rows),residuals:newTexture(gl.RGB32F,WIDTH,inRows(known)/ WIDTH),
positions:newTexture(gl.RGBA32F,WIDTH,inRows(count)/ WIDTH),pairs:newTexture(gl.RG32I,WIDTH,ring.pairs.length /(2*WIDTH)),
};
const positions=newBuffer(new Float32Array(4*inRows(count))),normals=newBuffer(new Float32Array(3*count)),added=new Float32Array(3*inRows(known));
const place=newPass(POSITIONS,["fields","weights","residuals"],{place:[4,own],vertex:[1,named]},positions);
const turn=newPass(NORMALS,["positions","pairs"],{place:[2,ring.places]},normals);
fill("fields",gl.RGBA,gl.FLOAT,texels);
fill("pairs",gl.RG_INTEGER,gl.INT,ring.pairs);
function evaluate(weights,residuals=null){
fill("weights",gl.RGBA,gl.FLOAT,weightRows(order,weights,weightTexels));
if(residuals){
added.set(residuals);
fill("residuals",gl.RGB,gl.FLOAT,added);
}
place(residuals?1:0);
gl.bindBuffer(gl.PIXEL_UNPACK_BUFFER,positions);
fill("positions",gl.RGBA,gl.FLOAT,0);
gl.bindBuffer(gl.PIXEL_UNPACK_BUFFER,null);
turn(0);
}
function newTexture(format,width,height){
const texture=gl.createTexture();
made.push(()=>gl.deleteTexture(texture));
gl.bindTexture(gl.TEXTURE_2D,texture);
gl.texStorage2D(gl.TEXTURE_2D,1,format,width,height);
for(const filter of[gl.TEXTURE_MIN_FILTER,gl.TEXTURE_MAG_FILTER])gl.texParameteri(gl.TEXTURE_2D,filter,gl.NEAREST);
return{texture,width,height};
}
function fill(name,format,type,data){
const{texture,width,height}=textures[name];
gl.bindTexture(gl.TEXTURE_2D,texture);
gl.pixelStorei(gl.UNPACK_ALIGNMENT,4);
gl.pixelStorei(gl.UNPACK_FLIP_Y_WEBGL,false);
gl.pixelStorei(gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL,false);
gl.texSubImage2D(gl.TEXTURE_2D,0,0,0,width,height,format,type,data);
}
function newBuffer(data){
const buffer=gl.createBuffer();
made.push(()=>gl.deleteBuffer(buffer));
gl.bindBuffer(gl.ARRAY_BUFFER,buffer);
gl.bufferData(gl.ARRAY_BUFFER,data,gl.DYNAMIC_COPY);
return buffer;
}
function newPass(vertexShader,samplers,attributes,target){
const program=newProgram(vertexShader),array=gl.createVertexArray(),displaced=gl.getUniformLocation(program,"displaced");
const feedback=gl.createTransformFeedback();
made.push(()=>[gl.deleteProgram(program),gl.deleteVertexArray(array),gl.deleteTransformFeedback(feedback)]);
gl.bindVertexArray(array);
for(const[name,[size,data]]of Object.entries(attributes)){
const location=gl.getAttribLocation(program,name);
newBuffer(data);
gl.enableVertexAttribArray(location);
gl.vertexAttribIPointer(location,size,gl.INT,0,0);
}
gl.bindVertexArray(null);
gl.useProgram(program);
samplers.forEach((name,unit)=>gl.uniform1i(gl.getUniformLocation(program,name),unit));
return(given)=>{
gl.useProgram(program);
gl.uniform1i(displaced,given);
samplers.forEach((name,unit)=>{
gl.activeTexture(gl.TEXTURE0 + unit);
gl.bindTexture(gl.TEXTURE_2D,textures[name].texture);
});
gl.bindVertexArray(array);
gl.bindBuffer(gl.ARRAY_BUFFER,null);
gl.bindTransformFeedback(gl.TRANSFORM_FEEDBACK,feedback);
gl.bindBufferBase(gl.TRANSFORM_FEEDBACK_BUFFER,0,target);
gl.enable(gl.RASTERIZER_DISCARD);
gl.beginTransformFeedback(gl.POINTS);
gl.drawArrays(gl.POINTS,0,count);
gl.endTransformFeedback();
gl.disable(gl.RASTERIZER_DISCARD);
gl.bindBufferBase(gl.TRANSFORM_FEEDBACK_BUFFER,0,null);
gl.bindTransformFeedback(gl.TRANSFORM_FEEDBACK,null);
gl.bindVertexArray(null);
gl.activeTexture(gl.TEXTURE0);
};
}
function newProgram(vertexShader){
const program=gl.createProgram();
for(const[kind,text]of[[gl.VERTEX_SHADER,vertexShader],[gl.FRAGMENT_SHADER,NOTHING]]){
const shader=gl.createShader(kind);
gl.shaderSource(shader,text);
gl.compileShader(shader);
gl.attachShader(program,shader);
gl.deleteShader(shader);
if(!gl.getShaderParameter(shader,gl.COMPILE_STATUS)&&!gl.isContextLost())throw new Error(gl.getShaderInfoLog(shader));
}
gl.transformFeedbackVaryings(program,["result"],gl.INTERLEAVED_ATTRIBS);
gl.linkProgram(program);
if(!gl.getProgramParameter(program,gl.LINK_STATUS)&&!gl.isContextLost())throw new Error(gl.getProgramInfoLog(program));
return program;
}
return{count,positions,normals,evaluate,dispose:()=>made.forEach((free)=>free())};
}
return{fieldTextures};
})();
const module46=(()=>{
const{MixseqError}=module0;
const MAGIC=0x46546c67,JSON_CHUNK=0x4e4f534a,NAME="MIXSEQ_mesh_sequence";
function readGlb(file){
const view=new DataView(file);
if(file.byteLength<20||view.getUint32(0,true)!==MAGIC||view.getUint32(16,true)!==JSON_CHUNK)throw new MixseqError("this is no GLB file");
const size=view.getUint32(12,true),start=28 + size,json=JSON.parse(new TextDecoder().decode(new Uint8Array(file,20,size)));
const mesh=json.meshes?.find(({extensions})=>extensions?.[NAME]),extension=mesh?.extensions[NAME];
if(!extension)throw new MixseqError("this GLB file has no mesh sequence");
const bytes=(number)=>{
const{byteOffset=0,byteLength}=json.bufferViews[number];
if(start + byteOffset + byteLength>file.byteLength)throw new MixseqError("this GLB file is not all there");
return new Uint8Array(file,start + byteOffset,byteLength);
};
const node=json.nodes?.find((each)=>each.mesh===json.meshes.indexOf(mesh));
return{
text:new TextDecoder().decode(bytes(extension.coding)),streams:bytes(extension.streams),
json,mesh,matrix:node?.matrix??[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1],
};
}
return{readGlb};
})();
const module47=(()=>{
const{open}=module33;
const{uvsOf}=module42;
const NAME="mixseq";
const COPIED=["polygons","triangles","fields","load"];
const GIVEN_AWAY=["uvs","weights","residuals","at","frame"];
function serve(port){
let sequence;
function answer(method,given){
if(method==="open")sequence=open(...given);
if(method==="begin")sequence.fields();
if(method==="uvs")return uvsOf(sequence);
if(COPIED.includes(method)||GIVEN_AWAY.includes(method))return sequence[method](...given);
const{streams,...facts}=sequence,sizes=streams.chunks.map(({coefficients})=>coefficients.length);
const first=streams.basis.reduce((sum,group)=>sum + group.length,streams.connectivity.length);
return method==="open"?{facts,sizes:[first,...sizes]}:null;
}
port.onmessage=({data:{number,method,given}})=>{
try{
const result=answer(method,given);
port.postMessage({number,result},GIVEN_AWAY.includes(method)&&result?[result.buffer]:[]);
}catch(error){
port.postMessage({number,error:error.message});
}
};
}
if(typeof WorkerGlobalScope !=="undefined"&&globalThis.name===NAME)serve(globalThis);
return{NAME,COPIED,GIVEN_AWAY,serve};
})();
const module48=(()=>{
const{MixseqError}=module0;
const{COPIED,GIVEN_AWAY,NAME}=module47;
async function openRemote(text,streams,address=import.meta.url){
const worker=new Worker(address,{type:"module",name:NAME}),waiting=new Map();
let last=0,ended=null;
const call=(method,...given)=>new Promise((resolve,reject)=>{
if(ended)throw ended;
waiting.set(++last,{resolve,reject});
worker.postMessage({number:last,method,given});
});
function close(reason="the sequence was closed"){
ended=new MixseqError(reason);
worker.terminate();
waiting.forEach(({reject})=>reject(ended));
waiting.clear();
}
worker.onmessage=({data:{number,result,error}})=>{
const{resolve,reject}=waiting.get(number);
waiting.delete(number);
if(error===undefined)resolve(result);
else reject(new MixseqError(error));
};
worker.onerror=({message})=>close(message||"the decoder did not start");
try{
const{facts,sizes}=await call("open",text,streams);
const methods=Object.fromEntries([...COPIED,...GIVEN_AWAY].map((method)=>[method,(...given)=>call(method,...given)]));
return{...facts,...methods,decode:(told)=>decodeAll(call,sizes,told),close};
}catch(error){
close();
throw error;
}
}
async function decodeAll(call,sizes,told=()=>{}){
const whole=sizes.reduce((sum,size)=>sum + size,0);
let done=0;
for(let k=0;k<sizes.length;k++){
await call(...(k?["load",k - 1]:["begin"]));
told((done+=sizes[k])/ whole);
}
}
return{openRemote};
})();
export const{open,Sequence, MixseqError }=module33;
export const{uvsOf,hardEdgesOf,surfaceOf}=module42;
export const{drawnMesh,takePositions,takeNormals}=module43;
export const{fieldTextures}=module45;
export const{readGlb}=module46;
export const{openRemote}=module48;
export const{NAME,COPIED,GIVEN_AWAY,serve}=module47;
